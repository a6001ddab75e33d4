//! `[access]`: who, beside the daemon's own user, may stop the arm and see what it does.

use super::reader::Section;
use super::schema::{Key, Kind, Length, TableSpec};
use serde::Serialize;

/// A user or a group, by name or number.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub enum Who {
    /// A user.
    User(String),
    /// The members of a group.
    Group(String),
}

/// Who may ask what over the arm's socket. The daemon's user and root always may.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct AccessConfig {
    /// Who may ask for `stop`, `hold`, `disarm`, the emergency stop and `speed`; `None` for the members of the daemon's own group.
    pub stop: Option<Vec<Who>>,
    /// Who may ask for `status`; `None` for the members of the daemon's own group.
    pub see: Option<Vec<Who>>,
}

const OWN_GROUP: &str = "the daemon's own group";

/// `[access]`.
pub static ACCESS: TableSpec = TableSpec {
    header: "[access]",
    name: "access",
    about: "Who may stop the arm and see what it does over its socket, beside the daemon's own user and root, who always \
            may. `\"alice\"` is a user, `\"@operators\"` the members of a group; those of a directory service are given by \
            number. Everything else (arming, targets, obstacles, encoders) goes over shared memory, which belongs to the \
            daemon's user alone.",
    keys: &[
        Key::optional(
            "stop",
            Kind::Texts(Length::Between(0, 32), 64),
            "",
            OWN_GROUP,
            "Users and groups that may ask for `stop`, `hold`, `disarm`, the emergency stop and `speed`.",
        ),
        Key::optional(
            "see",
            Kind::Texts(Length::Between(0, 32), 64),
            "",
            OWN_GROUP,
            "Users and groups that may ask for `status`.",
        ),
    ],
};

/// Reads `[access]`.
pub(super) fn read(table: &Section<'_>) -> AccessConfig {
    let list = |key: &'static str| {
        let texts = table.texts_opt(key)?;
        let who = texts.iter().map(|text| match text.strip_prefix('@') {
            Some("") => Err(text),
            Some(group) => Ok(Who::Group(group.to_owned())),
            None => Ok(Who::User(text.clone())),
        });
        match who.collect() {
            Ok(list) => Some(list),
            Err(_) => {
                table.refuse(key, "a group without a name", "permitted: \"user\", \"@group\", or their numbers");
                None
            }
        }
    };
    AccessConfig { stop: list("stop"), see: list("see") }
}
