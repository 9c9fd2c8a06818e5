//! Parts of the field that trials decide about.

use std::collections::BTreeSet;

use marf_field::{Background, Config, Trial};

/// A part of the field, and the configurations with and without it.
pub(super) struct Part {
    pub name: &'static str,
    /// Keys that decide instead of a trial where they are set.
    pub keys: &'static [&'static str],
    pub with: fn(&Config) -> Config,
    pub without: fn(&Config) -> Config,
}

/// Exposures are not tried: matched points decide about them ([`marf_scene::ToneDifference`]).
///
/// Whether colours depend on the direction is not tried: a short trial rejects it even where the whole training gains by it
/// (`benches/time.md`).
pub(super) const PARTS: [Part; 2] = [
    Part {
        name: "background",
        keys: &["background"],
        with: |config| Config {
            background: Background::Direction,
            ..config.clone()
        },
        without: |config| Config {
            background: Background::Black,
            ..config.clone()
        },
    },
    Part {
        name: "width",
        keys: &["density_width", "color_width", "color_layers"],
        with: |config| Config {
            density_width: 64,
            color_width: 64,
            ..config.clone()
        },
        without: |config| Config {
            density_width: 32,
            color_width: 32,
            color_layers: 1,
            ..config.clone()
        },
    },
];

/// Returns the keys of the field that these trials have decided.
pub(super) fn decided_keys(trials: &[Trial]) -> BTreeSet<&'static str> {
    let tried = trials.iter().filter(|trial| trial.with_db.is_some());
    let keys = tried.flat_map(|trial| {
        PARTS
            .iter()
            .filter(|part| part.name == trial.part)
            .flat_map(|part| part.keys)
    });
    keys.copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sides_of_a_part_differ_and_one_is_the_configuration_as_it_is() {
        let config = Config::default();
        for part in &PARTS {
            let known = serde_json::to_value(&config).unwrap();
            assert!(
                part.keys.iter().all(|key| known.get(key).is_some()),
                "{:?}",
                part.keys
            );
            let (with, without) = ((part.with)(&config), (part.without)(&config));
            assert_ne!(with, without, "{}", part.name);
            assert!(config == with || config == without, "{}", part.name);
            with.check().and(without.check()).unwrap();
        }
    }
}
