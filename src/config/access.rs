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

/// Who may do what over the arm's socket. The daemon's user and root always may.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize)]
pub struct AccessConfig {
    /// Who may ask for `stop`, `hold`, `disarm`, the emergency stop and `speed`; `None` for the members of the daemon's own group.
    pub stop: Option<Vec<Who>>,
    /// Who may ask for `status`; `None` for the members of the daemon's own group.
    pub see: Option<Vec<Who>>,
    /// Who may arm, track, home, clear and give targets; they may stop and see, too.
    pub command: Vec<Who>,
    /// Who may publish obstacles, and under which id; `None` for every id that is not named for others.
    pub publish: Vec<(Who, Option<u32>)>,
}

const OWN_GROUP: &str = "the daemon's own group";

/// `[access]`.
pub static ACCESS: TableSpec = TableSpec {
    header: "[access]",
    name: "access",
    about: "Who may do what over the arm's socket, beside the daemon's own user and root, who always may. `\"alice\"` is a \
            user, `\"@operators\"` the members of a group; those of a directory service are given by number. The kernel \
            says who is at the other end. Shared memory belongs to the daemon's user alone.",
    keys: &[
        Key::optional(
            "stop",
            Kind::Texts(Length::Between(0, 32), 64),
            "",
            OWN_GROUP,
            "Who may ask for `stop`, `hold`, `disarm`, the operator's emergency stop and `speed`.",
        ),
        Key::optional("see", Kind::Texts(Length::Between(0, 32), 64), "", OWN_GROUP, "Who may ask for `status`."),
        Key::optional(
            "command",
            Kind::Texts(Length::Between(0, 32), 64),
            "",
            "nobody else",
            "Who may `arm`, `track`, `home`, `clear` and give targets; they may stop and see, too.",
        ),
        Key::optional(
            "publish",
            Kind::Texts(Length::Between(0, 32), 64),
            "",
            "nobody else",
            "Who may publish obstacles. `\"camera=7\"` or `\"@cameras=7\"`: under source id 7, which is then nobody else's.",
        ),
    ],
};

/// Reads `[access]`.
pub(super) fn read(table: &Section<'_>) -> AccessConfig {
    let list = |key: &'static str| {
        let texts = table.texts_opt(key)?;
        let who: Option<Vec<Who>> = texts.iter().map(|text| who(text)).collect();
        if who.is_none() {
            table.refuse(key, "a user or group without a name", "permitted: \"user\", \"@group\", or their numbers");
        }
        who
    };
    let publishers = || {
        let texts = table.texts_opt("publish")?;
        let both: Option<Vec<_>> = texts.iter().map(|text| publisher(text)).collect();
        if both.is_none() {
            let permitted = "permitted: \"user\", \"@group\", or with a source id: \"user=7\", \"@group=7\"";
            table.refuse("publish", "not a user or group with or without a source id", permitted);
        }
        both
    };
    AccessConfig {
        stop: list("stop"),
        see: list("see"),
        command: list("command").unwrap_or_default(),
        publish: publishers().unwrap_or_default(),
    }
}

fn who(text: &str) -> Option<Who> {
    match text.strip_prefix('@').unwrap_or(text) {
        "" => None,
        group if text.starts_with('@') => Some(Who::Group(group.to_owned())),
        user => Some(Who::User(user.to_owned())),
    }
}

fn publisher(text: &str) -> Option<(Who, Option<u32>)> {
    match text.split_once('=') {
        None => Some((who(text)?, None)),
        Some((name, id)) => Some((who(name)?, Some(id.parse().ok()?))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_publisher_is_a_user_or_a_group_with_or_without_an_id() {
        let user = |name: &str| Who::User(name.into());
        assert_eq!(publisher("camera"), Some((user("camera"), None)));
        assert_eq!(publisher("@54=7"), Some((Who::Group("54".into()), Some(7))));
        for bad in ["", "@", "=7", "@=7", "camera=", "camera=x", "camera=-1", "camera=4294967296"] {
            assert_eq!(publisher(bad), None, "{bad}");
        }
    }
}
