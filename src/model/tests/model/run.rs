use marf_engine::OutputName;
use marf_model::{
    Run,
    product::{origins, products},
};

use super::common::{Pipeline, fresh_store, ids, picture};

/// `input of node = output of node`, for all nodes.
fn inputs(run: &Run<'_>) -> Vec<String> {
    let mut lines = Vec::new();
    for node in &run.nodes {
        for (name, input) in &node.run.inputs {
            let maker = |made_by: &OutputName| format!("{} {}", made_by.node, made_by.output);
            let made_by = input.made_by.as_ref().map_or("archive".to_owned(), maker);
            lines.push(format!("{} {name} = {made_by}", node.run.name));
        }
    }
    lines
}

#[test]
fn a_run_leads_from_every_node_to_the_outputs_it_read() {
    let (_dir, store) = fresh_store();
    let first = Pipeline::default().run(&store);
    let second = Pipeline::default().run(&store);
    for run in [first, second] {
        let lineage = Run::open(&store, run.number).unwrap();
        assert_eq!(
            inputs(&lineage),
            [
                "archive listing = archive",
                "pick photos = archive photos",
                "sum photos = pick photos",
                "many sum = sum sum",
                "many/draw-0 sum = sum sum",
                "many/draw-1 sum = sum sum",
            ],
            "run {}",
            run.number
        );
        assert_eq!(lineage.record.root, run.root);
        for node in &lineage.nodes {
            let action = node.action.as_ref().unwrap();
            assert_eq!(Some(action.key()), node.run.key);
            let names: Vec<_> = node
                .run
                .inputs
                .iter()
                .map(|(name, input)| (name, input.digest))
                .collect();
            assert!(
                names
                    .into_iter()
                    .eq(action.inputs.iter().map(|(name, digest)| (name, *digest)))
            );
            assert!(node.record.is_some() && node.run.started_unix_s.is_some());
        }
    }
}

#[test]
fn upstream_are_the_makers_of_inputs_and_their_children() {
    let (_dir, store) = fresh_store();
    let run = Pipeline::default().run(&store);
    let lineage = Run::new(&store, run).unwrap();
    let names = |of: &str| -> Vec<String> {
        lineage
            .upstream(of)
            .iter()
            .map(|node| node.run.name.clone())
            .collect()
    };
    assert_eq!(names("archive"), ["archive"]);
    assert_eq!(names("sum"), ["archive", "pick", "sum"]);
    assert_eq!(names("many/draw-1"), ["archive", "pick", "sum", "many/draw-1"]);
    assert_eq!(
        names("many"),
        ["archive", "pick", "sum", "many", "many/draw-0", "many/draw-1"]
    );
    assert_eq!(names("none"), Vec::<String>::new());
    let sources: Vec<_> = lineage.sources().map(|node| node.run.name.as_str()).collect();
    assert_eq!(sources, ["archive"]);
}

#[test]
fn products_name_the_bytes_and_where_they_came_from() {
    let (_dir, store) = fresh_store();
    let lineage = Run::new(&store, Pipeline::default().run(&store)).unwrap();
    let parts = lineage.node("archive").unwrap().parts(&store).unwrap();
    assert_eq!(parts.iter().map(|part| part.shard).collect::<Vec<_>>(), [1, 2]);
    let products = products(&store, &parts[1]).unwrap();
    assert_eq!(
        products
            .iter()
            .map(|product| product.id.clone())
            .collect::<Vec<_>>(),
        ids(2)
    );
    let origin = &products[0].origins["image"];
    assert_eq!(origin.url.as_deref(), Some("https://host/a2.png"));
    assert_eq!(
        origin.sha256,
        Some(marf_cache::Sha256::from_content(&picture("a2")))
    );
    assert_eq!(*store.get(&products[0].blobs["image"]).unwrap(), *picture("a2"));
    assert_eq!(origins(&store, &parts[0]).unwrap().len(), 3);
}
