//! How often photos are decoded: a decoding reads the photo from the store, a memo does not.

use crate::common::{self, NoMemos, inputs, put_scene, run, small, stage};
use marf_scene::{Photo, Scene, encode_png};
use marf_schema::train::TrainParams;
use marf_stage::{Ctx, Define, Expand, Inputs, Outputs, Params, harness::Harness};
use marf_train::{Bootstrap, Evaluate, Train, Tune};
use serde_json::json;

/// Returns a scene of twelve photos, no two with the same bytes: the ball looks alike from several sides.
fn scene(harness: &Harness) -> Scene {
    let mut scene = common::scene(harness, 12);
    for (number, frame) in (0_u8..).zip(&mut scene.frames) {
        let mut image = Photo::decode(&harness.get(&frame.image).unwrap()).unwrap().image;
        image.pixels[0] = [number; 3];
        frame.image = harness.put(&encode_png(&image).unwrap());
    }
    scene
}

/// Runs the trainings that a stage asks for and reduces their outputs.
fn expand(ctx: &Ctx<'_>, stage: &impl Expand, inputs: &Inputs) -> (Outputs, usize) {
    let nodes = stage.expand(ctx, inputs).unwrap();
    let trained = nodes.into_iter().map(|node| {
        assert_eq!(node.stage, TrainParams::STAGE);
        let mut params: TrainParams = serde_json::from_value(node.params).unwrap();
        params.field = serde_json::from_value(small()).unwrap();
        run(&Train::new(params).unwrap(), ctx, &node.inputs).unwrap()
    });
    let trained: Vec<Outputs> = trained.collect();
    (stage.reduce(ctx, inputs, &trained).unwrap(), trained.len())
}

#[test]
fn the_trainings_of_the_default_pipeline_decode_each_photo_once_a_working_size() {
    let harness = Harness::default();
    let (ctx, scene) = (harness.ctx(), scene(&harness));
    let inputs = inputs(&[("scene", put_scene(&harness, &scene))]);

    // Nine trials of one rung and the scatter, at another working size than the rest.
    let tune: Tune = stage(json!({"scale": 3, "steps": 2}));
    let (_, trials) = expand(&ctx, &tune, &inputs);
    let clocked: Train = stage(json!({"budget": "40ms", "scale": 2, "field": small()}));
    run(&clocked, &ctx, &inputs).unwrap();
    let train: Train = stage(json!({"steps": 2, "scale": 2, "field": small()}));
    let trained = run(&train, &ctx, &inputs).unwrap();
    let evaluate: Evaluate = stage(json!({"views": "all"}));
    run(&evaluate, &ctx, &Inputs(trained)).unwrap();
    let bootstrap: Bootstrap = stage(json!({"steps": 2, "scale": 2}));
    let (_, members) = expand(&ctx, &bootstrap, &inputs);

    assert_eq!(trials + 1 + members, 16);
    for frame in &scene.frames {
        // Trials never look at the photos that the scene holds out.
        let sizes = if frame.held_out { 1 } else { 2 };
        assert_eq!(harness.reads(&frame.image), sizes, "photo {}", frame.id);
    }
}

#[test]
fn a_training_without_memos_gives_the_same_bytes_and_decodes_photos_twice_that_judge_it() {
    let harness = Harness::default();
    let scene = scene(&harness);
    let inputs = inputs(&[("scene", put_scene(&harness, &scene))]);
    let train: Train = stage(json!({"steps": 16, "scale": 2, "field": small()}));
    let without = Ctx {
        memos: &NoMemos,
        ..harness.ctx()
    };
    let expected = run(&train, &without, &inputs).unwrap();
    // Before the training, and when the field is measured: on those held out and on as many others.
    let twice = |held_out: bool| {
        let frames = scene.frames.iter().filter(|frame| frame.held_out == held_out);
        frames.filter(|frame| harness.reads(&frame.image) == 2).count()
    };
    let held_out = scene.frames.iter().filter(|frame| frame.held_out).count();
    assert_eq!((twice(true), twice(false)), (held_out, held_out));
    for _ in 0..2 {
        assert_eq!(run(&train, &harness.ctx(), &inputs).unwrap(), expected);
    }
}
