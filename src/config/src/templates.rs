/// A commented pipeline that `marf init` writes.
pub struct Template {
    /// Name on the command line.
    pub name: &'static str,
    /// One line about it.
    pub about: &'static str,
    /// The file.
    pub text: &'static str,
}

/// Every template, the default first.
pub const TEMPLATES: [Template; 6] = [
    Template {
        name: "demo",
        about: "a built-in Mars, offline, with ground truth",
        text: include_str!("../../../pipeline.toml"),
    },
    Template {
        name: "mission",
        about: "the built-in Mars at three places, each a scene of its own",
        text: include_str!("../../../pipelines/mission.toml"),
    },
    Template {
        name: "folder",
        about: "photos in a folder",
        text: include_str!("../../../pipelines/folder.toml"),
    },
    Template {
        name: "perseverance",
        about: "Mastcam-Z of Mars 2020, from the Planetary Data System",
        text: include_str!("../../../pipelines/perseverance.toml"),
    },
    Template {
        name: "curiosity",
        about: "Mastcam of MSL, from the Planetary Data System",
        text: include_str!("../../../pipelines/curiosity.toml"),
    },
    Template {
        name: "ingenuity",
        about: "the helicopter's colour camera, from the Planetary Data System",
        text: include_str!("../../../pipelines/ingenuity.toml"),
    },
];

/// Returns a template by name.
pub fn template(name: &str) -> Option<&'static Template> {
    TEMPLATES.iter().find(|template| template.name == name)
}
