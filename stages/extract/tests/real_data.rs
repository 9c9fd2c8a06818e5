//! Real files of three missions.

mod common;

use common::{Brought, bring, folder, real};

#[test]
fn every_navcam_record_becomes_a_photo_with_its_camera() {
    let Some(path) = real("m2020_navcam_feed") else {
        return;
    };
    let brought = bring(folder(&path)).unwrap();
    assert_eq!(brought.rows.len(), 36);
    print_table(&brought);
    assert!(
        brought.verdicts.iter().all(marf_stage::Verdict::keeps),
        "{:#?}",
        brought.verdicts
    );
    for (sol, row) in &brought.rows {
        let facts = brought.facts(&row.id);
        let prior = facts
            .prior
            .unwrap_or_else(|| panic!("{}: {:?}", row.id, facts.notes));
        assert_eq!(facts.sol, Some(*sol), "{}", row.id);
        assert!(
            prior.model.e.is_some() && prior.site_from_frame.is_some(),
            "{}",
            row.id
        );
        let scale = focal_px(&prior.model);
        let near = [739.7, 1479.2, 2958.5]
            .iter()
            .any(|focal| (scale / focal - 1.0_f64).abs() < 0.01);
        assert!(near, "{}: {scale}", row.id);
    }
}

/// |A x H|.
fn focal_px(model: &marf_scene::Cahvor) -> f64 {
    let (a, h) = (nalgebra::Vector3::from(model.a), nalgebra::Vector3::from(model.h));
    a.cross(&h).norm()
}

fn print_table(brought: &Brought) {
    println!("| product | file | size | bands | sol | filter | model | frame, pose | counter | notes |");
    for (_, row) in &brought.rows {
        let facts = brought.facts(&row.id);
        let camera = facts.prior.as_ref().map_or_else(
            || "none | - | -".to_owned(),
            |prior| {
                let kind = match (prior.model.o, prior.model.e) {
                    (_, Some(_)) => "CAHVORE",
                    (Some(_), None) => "CAHVOR",
                    _ => "CAHV",
                };
                let pose = if prior.site_from_frame.is_some() {
                    "posed"
                } else {
                    "no pose"
                };
                let counter = &prior.motion_counter;
                format!(
                    "{kind} {:.1} px | {}, {pose} | {counter:?}",
                    focal_px(&prior.model),
                    prior.frame
                )
            },
        );
        println!(
            "| {} | {} | {}x{} | {} | {:?} | {:?} | {camera} | {:?} |",
            row.id, facts.file, facts.width, facts.height, facts.bands, facts.sol, facts.filter, facts.notes
        );
    }
    for verdict in brought.verdicts.iter().filter(|verdict| !verdict.keeps()) {
        println!("| {} | {} | {} |", verdict.file, verdict.verdict, verdict.reason);
    }
}
