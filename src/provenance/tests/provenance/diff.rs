use marf_model::Run;
use marf_provenance::diff::{NodeDiff, Presence, diff};

use super::common::{Pipeline, fresh_store};

fn between(one: &Pipeline, two: &Pipeline) -> Vec<NodeDiff> {
    let (_dir, store) = fresh_store();
    let (one, two) = (one.run(&store), two.run(&store));
    diff(&Run::new(&store, one).unwrap(), &Run::new(&store, two).unwrap()).unwrap()
}

fn named<'a>(found: &'a [NodeDiff], node: &str) -> &'a NodeDiff {
    found
        .iter()
        .find(|diff| diff.node == node)
        .unwrap_or_else(|| panic!("{node} is not in {found:?}"))
}

#[test]
fn equal_runs_do_not_differ() {
    assert_eq!(between(&Pipeline::default(), &Pipeline::default()), []);
}

#[test]
fn a_new_sol_and_another_choice_are_told_by_product() {
    let found = between(
        &Pipeline::default(),
        &Pipeline {
            sols: 3,
            ..Pipeline::default()
        },
    );
    assert_eq!(named(&found, "archive").products.added, ["a3", "b3", "c3"]);
    assert_eq!(named(&found, "sum").presence, Presence::Both);
    let found = between(
        &Pipeline::default(),
        &Pipeline {
            without: "c1",
            ..Pipeline::default()
        },
    );
    let pick = named(&found, "pick");
    let words: Vec<String> = pick.changes.iter().map(ToString::to_string).collect();
    assert_eq!(words, ["params.without: \"b1\" -> \"c1\""]);
    assert_eq!(
        (pick.products.added.as_slice(), pick.products.removed.as_slice()),
        (["b1".to_owned()].as_slice(), ["c1".to_owned()].as_slice())
    );
    assert!(found.iter().all(|diff| diff.node != "archive"));
    let sum = named(&found, "sum");
    assert!(
        sum.outputs.is_empty() && sum.changes[0].to_string() == "input photos changed",
        "{sum:?}"
    );
}
