//! What a recording tells of its run beside messages.

use super::viewer::Viewer;
use crate::ipc::payload::SCHEMA_VERSION;
use mcap::Attachment;
use serde::Serialize;
use std::borrow::Cow;
use std::collections::BTreeMap;

/// Name of the attachment with the files of the configuration, as one that can be loaded again.
pub const CONFIGURATION: &str = "configuration.toml";
/// Name of the attachment with every setting as it came out, in SI units.
pub const SETTINGS: &str = "settings.json";
/// Name of the attachment that says what wrote the recording.
pub const SOFTWARE: &str = "software.json";

/// What a recording tells of its run beside messages: facts in its metadata, texts as attachments, and what viewers are
/// shown.
#[derive(Debug, Clone)]
pub struct About {
    pub(super) arm: String,
    pub(super) metadata: BTreeMap<String, String>,
    pub(super) viewer: Option<Viewer>,
    attachments: Vec<(&'static str, &'static str, String)>,
}

impl About {
    /// Of a run of an arm, with the software's version attached.
    pub fn new(arm: &str) -> Self {
        let metadata = [
            ("arm", arm.to_owned()),
            ("schema_version", SCHEMA_VERSION.to_string()),
            ("sinew_version", env!("CARGO_PKG_VERSION").to_owned()),
        ];
        let software = serde_json::json!({
            "name": "sinew",
            "version": env!("CARGO_PKG_VERSION"),
            "schema_version": SCHEMA_VERSION,
            "system": std::env::consts::OS,
            "processor": std::env::consts::ARCH,
            "debug_assertions": cfg!(debug_assertions),
        });
        Self {
            arm: arm.to_owned(),
            metadata: metadata.map(|(name, value)| (name.to_owned(), value)).into(),
            viewer: None,
            attachments: vec![(SOFTWARE, "application/json", format!("{software:#}\n"))],
        }
    }

    /// With a fact (scenario, seed).
    #[must_use]
    pub fn with(mut self, name: &str, value: impl ToString) -> Self {
        self.metadata.insert(name.to_owned(), value.to_string());
        self
    }

    /// With what viewers are shown.
    #[must_use]
    pub fn shown(mut self, viewer: Option<Viewer>) -> Self {
        self.viewer = viewer;
        self
    }

    /// With the text of the configuration's files ([`CONFIGURATION`]).
    #[must_use]
    pub fn configured(mut self, text: Option<String>) -> Self {
        self.attachments.extend(text.map(|text| (CONFIGURATION, "application/toml", text)));
        self
    }

    /// With every setting as it came out ([`SETTINGS`]); numbers that are none are null.
    #[must_use]
    pub fn set(mut self, settings: &impl Serialize) -> Self {
        // What could not be written would be a map whose keys are no texts; settings have none.
        if let Ok(text) = serde_json::to_string_pretty(settings) {
            self.attachments.push((SETTINGS, "application/json", text));
        }
        self
    }

    /// The attachments, as the container takes them.
    pub(super) fn attachments(&self) -> impl Iterator<Item = Attachment<'_>> {
        self.attachments.iter().map(|(name, media_type, text)| Attachment {
            log_time: 0,
            create_time: 0,
            name: (*name).to_owned(),
            media_type: (*media_type).to_owned(),
            data: Cow::Borrowed(text.as_bytes()),
        })
    }
}
