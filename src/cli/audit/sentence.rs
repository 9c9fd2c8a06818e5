//! The answer of `marf audit` in a sentence that takes no knowledge of marf.

use std::collections::BTreeSet;

use marf_engine::{OutputName, document};
use marf_export::iso_time;
use marf_export::verify::{Role, Trace};
use marf_progress::format::count;
use marf_provenance::find::Place;
use marf_run::audit::identity::Identity;
use marf_run::audit::{AuditReport, Origin, PhotoCount};
use marf_run::{Answer, scenes};
use marf_schema::output::{CHANGE_MAPS, MAPS, SURFACE_MAPS, VIDEO, WEIGHTS};

/// Returns the answer on a file.
pub(super) fn answer(report: &AuditReport) -> String {
    let origin = report.lineage.first();
    match &report.identity {
        Identity::NotOurs { .. } => {
            "marf does not know this file: no run of this store made or read it.".to_owned()
        }
        Identity::Elsewhere { .. } => "This file has the bytes that its mark names, but this store does not have the original. It is from \
             another store, or was removed from this one."
            .to_owned(),
        Identity::Altered { because, share, .. } => {
            let Some(origin) = origin else {
                return format!("This file was altered: {because}. This store does not have the original.");
            };
            let equal = share.map_or_else(String::new, |share| {
                format!(" {:.1} % of the bytes are the same.", floor_percent(share))
            });
            let (noun, made) = (noun(&origin.maker.place), origin_text(origin));
            format!("This file was altered: {because}. The closest original is a {noun} that {made}.{equal}")
        }
        Identity::Whole { .. } => {
            let Some(origin) = origin else {
                return format!("This file is known to marf, but its run cannot be read. {}", state(report));
            };
            let (noun, made) = (noun(&origin.maker.place), origin_text(origin));
            let uses = report.uses.as_ref().map_or_else(String::new, |uses| {
                format!(" It is part of {}.", count(uses.runs.len(), "run"))
            });
            format!("This {noun} {made}.{uses} {}", state(report))
        }
    }
}

/// Returns the answer on a file by the run of a crate, all of whose bytes were checked.
pub(super) fn answer_of_crate(trace: &Trace) -> String {
    let by = format!("{} on {}", trace.program, date(trace.started_unix_s));
    let what = match trace.is.first() {
        Some(Role::Photo { role, .. }) => format!("This {} was read by {by}.", noun_of_role(role)),
        Some(Role::Output { output, .. }) => {
            let photos = PhotoCount {
                used: trace.products.len() as u64,
                read: trace.photos_read,
                sols: BTreeSet::new(),
            };
            format!(
                "This {} was computed by {by} from {}.",
                noun_of_output(output),
                photos_text(&photos)
            )
        }
        None => format!("This file belongs to a run of {by}."),
    };
    format!("{what} All bytes of the file and of the crate are intact.")
}

/// Returns what the check found of the bytes of a file that is itself intact.
fn state(report: &AuditReport) -> String {
    let verified = report.verified.as_ref();
    let lost = verified.map_or(0, |verified| verified.missing.len());
    match report.answer {
        Answer::Altered => {
            let faults = verified.map_or(0, |verified| verified.faults.len());
            format!(
                "Its own bytes are intact, but there {} in what it was made from or in the store.",
                are(faults, "fault")
            )
        }
        Answer::Incomplete if lost > 0 => format!(
            "Its own bytes are intact, but {} that it was made from {} no longer in the store.",
            count(lost, "object"),
            if lost == 1 { "is" } else { "are" }
        ),
        Answer::Incomplete => {
            "Its own bytes are intact, but not everything that it was made from is still in the store."
                .to_owned()
        }
        Answer::Changed => format!(
            "All bytes are intact in the store, but the archive has changed {} since.",
            count(report.changed.len(), "file")
        ),
        _ if verified.is_some() => {
            "All bytes are intact, those of the file and of everything that it was made from.".to_owned()
        }
        _ => "Its bytes are intact.".to_owned(),
    }
}

fn are(number: usize, noun: &str) -> String {
    let verb = if number == 1 { "is" } else { "are" };
    format!("{verb} {}", count(number, noun))
}

/// Returns who made something, when and from what, as the end of a sentence.
fn origin_text(origin: &Origin) -> String {
    let by = match origin.maker.made_in {
        Some(_) => format!("{} on {}", origin.program, date(origin.started_unix_s)),
        // The run that made it is gone. An old one that has it is left.
        None => format!("marf on or before {}", date(origin.started_unix_s)),
    };
    let photos = |before: &str| {
        let photos = origin.photos.as_ref().filter(|photos| photos.read > 0);
        photos.map_or_else(String::new, |photos| format!(" {before} {}", photos_text(photos)))
    };
    match &origin.maker.place {
        Place::Product { .. } | Place::File { .. } => format!("was read by {by}"),
        Place::Output(_) | Place::Sol { .. } => format!("was computed by {by}{}", photos("from")),
        Place::Root | Place::Document(_) | Place::Action(_) | Place::Stored(_) => {
            format!("is a record of a run by {by}{}", photos("on"))
        }
    }
}

/// Returns `60 of 68 photos of sols 1 to 2`.
fn photos_text(photos: &PhotoCount) -> String {
    let read = count(photos.read as usize, "photo");
    let used = if photos.used == photos.read {
        read
    } else {
        format!("{} of {read}", photos.used)
    };
    let (first, last) = (photos.sols.first(), photos.sols.last());
    let sols = match (first, last) {
        (Some(first), Some(last)) if first == last => format!(" of sol {first}"),
        (Some(first), Some(last)) if photos.sols.len() == (last - first) as usize + 1 => {
            format!(" of sols {first} to {last}")
        }
        (Some(first), Some(last)) => format!(" of {} sols from {first} to {last}", photos.sols.len()),
        _ => String::new(),
    };
    format!("{used}{sols}")
}

fn date(unix_s: u64) -> String {
    let time = iso_time(unix_s);
    time.split('T').next().unwrap_or(&time).to_owned()
}

fn noun(place: &Place) -> &'static str {
    match place {
        Place::Output(OutputName { output, .. }) => noun_of_output(output),
        Place::Product { role, .. } => noun_of_role(role),
        Place::Document(name) if name == document::REPORT || scenes::is_page(name) => "report",
        _ => "file",
    }
}

fn noun_of_role(role: &str) -> &'static str {
    match role {
        "image" | "raw" => "photo",
        "label" => "label",
        _ => "file",
    }
}

fn noun_of_output(output: &str) -> &'static str {
    let ending = output.rsplit_once('.').map_or("", |(_, ending)| ending);
    let is_map = [MAPS, SURFACE_MAPS, CHANGE_MAPS]
        .iter()
        .any(|folder| output.starts_with(folder));
    match ending {
        _ if output == VIDEO => "film",
        _ if output == WEIGHTS => "trained field",
        "png" | "tif" if is_map => "map",
        "png" | "jpg" => "picture",
        "ply" | "glb" => "3-D model",
        _ => "file",
    }
}

/// Returns a share in percent, rounded down, so that a file that differs never shows as the same.
fn floor_percent(share: f64) -> f64 {
    (share * 1000.0).floor() / 10.0
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_cache::Digest;
    use marf_provenance::verify::{Fault, Lost, Verified};
    use marf_run::audit::{Changed, identity::Identity};

    #[test]
    fn the_state_of_an_intact_file_says_what_is_not_intact_besides() {
        let digest = Digest::from_content(b"x");
        let fault = Fault {
            object: None,
            of: "train".to_owned(),
            what: "other bytes".to_owned(),
        };
        let lost = || Lost {
            digest,
            role: "output",
            of: "train".to_owned(),
        };
        let checked = |faults: Vec<Fault>, missing: Vec<Lost>| {
            Some(Verified {
                objects: 9,
                bytes: 9,
                products: 0,
                faults,
                missing,
            })
        };
        let changed = || Changed {
            file: "A.png".to_owned(),
            sol: 1,
            used: digest,
            now: Vec::new(),
        };
        let said = |answer, verified, changed| {
            state(&AuditReport {
                file: "f".into(),
                answer,
                identity: Identity::NotOurs { content: digest },
                lineage: Vec::new(),
                uses: None,
                verified,
                changed,
            })
        };
        assert_eq!(
            said(Answer::Altered, checked(vec![fault], Vec::new()), Vec::new()),
            "Its own bytes are intact, but there is 1 fault in what it was made from or in the store."
        );
        assert_eq!(
            said(Answer::Incomplete, checked(Vec::new(), vec![lost()]), Vec::new()),
            "Its own bytes are intact, but 1 object that it was made from is no longer in the store."
        );
        assert_eq!(
            said(
                Answer::Incomplete,
                checked(Vec::new(), vec![lost(), lost()]),
                Vec::new()
            ),
            "Its own bytes are intact, but 2 objects that it was made from are no longer in the store."
        );
        assert_eq!(
            said(Answer::Incomplete, None, Vec::new()),
            "Its own bytes are intact, but not everything that it was made from is still in the store."
        );
        assert_eq!(
            said(Answer::Changed, None, vec![changed(), changed()]),
            "All bytes are intact in the store, but the archive has changed 2 files since."
        );
    }

    #[test]
    fn photos_have_their_total_and_their_sols() {
        for (used, read, sols, text) in [
            (98, 98, &[1, 2][..], "98 photos of sols 1 to 2"),
            (60, 68, &[1], "60 of 68 photos of sol 1"),
            (9, 9, &[3, 5, 90], "9 photos of 3 sols from 3 to 90"),
            (1, 1, &[], "1 photo"),
        ] {
            let photos = PhotoCount {
                used,
                read,
                sols: sols.iter().copied().collect(),
            };
            assert_eq!(photos_text(&photos), text);
        }
    }

    #[test]
    fn a_file_has_the_word_that_people_use() {
        for (output, word) in [
            ("video", "film"),
            ("maps/a-std.png", "map"),
            ("map/height.png", "map"),
            ("map/height.pgw", "file"),
            ("heldout/a.png", "picture"),
            ("mesh.ply", "3-D model"),
            ("weights", "trained field"),
            ("metrics", "file"),
        ] {
            assert_eq!(noun_of_output(output), word, "{output}");
        }
    }

    #[test]
    fn a_share_of_less_than_all_is_never_all() {
        assert_eq!(floor_percent(0.999_99), 99.9);
        assert_eq!(floor_percent(1.0), 100.0);
    }
}
