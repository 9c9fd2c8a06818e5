use marf_cache::Digest;
use marf_model::Run;
use marf_provenance::taint::{Tainted, product_of, tainted};

use super::common::{Pipeline, fresh_store, picture};

fn taint_of(lineage: &Run<'_>, wanted: &str) -> Option<Tainted> {
    let product = product_of(lineage, wanted).unwrap()?;
    tainted(lineage, &product).unwrap()
}

fn nodes(tainted: &Tainted) -> Vec<&str> {
    tainted.nodes.iter().map(|node| node.node.as_str()).collect()
}

#[test]
fn a_product_goes_into_everything_that_follows_unless_it_is_rejected() {
    let (_dir, store) = fresh_store();
    let lineage = Run::new(&store, Pipeline::default().run(&store)).unwrap();
    let kept = taint_of(&lineage, "a1").unwrap();
    assert_eq!(
        nodes(&kept),
        ["archive", "pick", "sum", "many", "many/draw-0", "many/draw-1"]
    );
    assert_eq!(kept.rejected_by, Vec::<String>::new());
    assert_eq!(kept.nodes[0].through, ["archive"]);
    assert_eq!(kept.nodes[2].through, ["photos"]);
    assert!(kept.nodes[2].outputs.contains_key("sum"));
    let rejected = taint_of(&lineage, "b1").unwrap();
    assert_eq!(nodes(&rejected), ["archive", "pick"]);
    assert_eq!(rejected.rejected_by, ["pick"]);
    assert!(rejected.nodes[1].outputs.is_empty(), "{rejected:?}");
}

#[test]
fn a_product_is_known_by_id_by_file_and_by_digest() {
    let (_dir, store) = fresh_store();
    let lineage = Run::new(&store, Pipeline::default().run(&store)).unwrap();
    let digest = Digest::from_content(&picture("c2")).to_string();
    for wanted in ["c2", "c2.png", &digest] {
        assert_eq!(
            product_of(&lineage, wanted).unwrap().unwrap().id,
            "c2",
            "{wanted}"
        );
    }
    assert_eq!(product_of(&lineage, "c3").unwrap(), None);
}
