use marf_cache::Digest;
use marf_engine::OutputName;
use marf_provenance::find::{Place, find};

use super::common::{Pipeline, fresh_store, picture};

fn output(node: &str, output: &str) -> Place {
    Place::Output(OutputName {
        node: node.to_owned(),
        output: output.to_owned(),
    })
}

#[test]
fn every_kind_of_content_is_found_with_its_maker() {
    let (_dir, store) = fresh_store();
    let run = Pipeline::default().run(&store);
    let photos = run.node("pick").unwrap().outputs["photos"].digest;
    let leaf = marf_model::product::set(&store, &photos).unwrap().leaves[1].leaf;
    let key = run.node("sum").unwrap().key.unwrap();
    let cases = [
        (run.root.unwrap(), Place::Root),
        (Digest::from_content(b"5 rows times 1"), output("sum", "sum")),
        (Digest::from_content(b"mean of 2"), output("many", "mean")),
        (key, Place::Action("sum".to_owned())),
        (
            leaf,
            Place::Sol {
                node: "archive".to_owned(),
                output: "photos".to_owned(),
                sol: 2,
            },
        ),
        (
            Digest::from_content(&picture("c1")),
            Place::Product {
                node: "archive".to_owned(),
                sol: 1,
                id: "c1".to_owned(),
                role: "image".to_owned(),
            },
        ),
    ];
    for (content, place) in cases {
        let makers = find(&store, std::slice::from_ref(&run), &content).unwrap();
        let found = makers.iter().find(|maker| maker.place == place);
        let found = found.unwrap_or_else(|| panic!("{place:?} is not in {makers:?}"));
        assert_eq!(
            (found.runs.as_slice(), found.made_in),
            ([1].as_slice(), Some(1)),
            "{place:?}"
        );
    }
    assert_eq!(
        find(&store, &[run], &Digest::from_content(b"foreign")).unwrap(),
        []
    );
}

/// One sum in two runs is one maker. The same text from other parameters is another.
#[test]
fn a_reused_result_has_the_run_that_made_it_and_an_ambiguous_content_all_makers() {
    let (_dir, store) = fresh_store();
    let pipeline = Pipeline::default();
    let first = pipeline.run(&store);
    let second = pipeline.run(&store);
    // Without another photo of the sol the sum of rows is the same text, made under another key.
    let third = Pipeline {
        without: "c1",
        ..pipeline
    }
    .run(&store);
    let makers = find(
        &store,
        &[first, second, third],
        &Digest::from_content(b"5 rows times 1"),
    )
    .unwrap();
    let mut runs: Vec<_> = makers
        .iter()
        .map(|maker| (maker.runs.clone(), maker.made_in))
        .collect();
    runs.sort();
    assert_eq!(runs, [(vec![1, 2], Some(1)), (vec![3], Some(3))]);
    assert!(makers.iter().all(|maker| maker.place == output("sum", "sum")));
}

#[test]
fn where_the_run_that_made_it_is_gone_the_oldest_that_has_it_is_told() {
    let (_dir, store) = fresh_store();
    Pipeline::default().run(&store);
    let second = Pipeline::default().run(&store);
    store.remove_run(1).unwrap();
    let makers = find(&store, &[second], &Digest::from_content(b"5 rows times 1")).unwrap();
    assert_eq!(
        (makers[0].runs.as_slice(), makers[0].made_in),
        ([2].as_slice(), None)
    );
}
