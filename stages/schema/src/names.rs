//! Which stage each type belongs to, and in which output a JSON document is stored.

use marf_stage::{Document, Params};

use crate::{
    bootstrap, calibrate, cameras, changes, depth, evaluate, folds, masks, partial, render, scenes, surface,
    ties, train, tune, video,
};

/// One row a stage: its name, its parameters, and its JSON outputs with their types.
macro_rules! stages {
    ($($stage:literal, $params:ty: { $($output:literal: $document:ty),* };)*) => {$(
        impl Params for $params {
            const STAGE: &'static str = $stage;
        }
        $(
            impl Document for $document {
                const STAGE: &'static str = $stage;
                const OUTPUT: &'static str = $output;
            }
        )*
    )*};
}

stages! {
    "bootstrap", bootstrap::BootstrapParams: { "members": bootstrap::MemberFields, "metrics": bootstrap::Metrics };
    // `calibrate::Metrics` implements `Document` itself: its bytes have a form of their own.
    "calibrate", calibrate::CalibrateParams: {};
    "cameras", cameras::CamerasParams: {};
    "changes", changes::ChangesParams: { "changes": changes::ChangesReport };
    "depth", depth::DepthParams: { "metrics": depth::Metrics };
    "evaluate", evaluate::EvaluateParams: { "metrics": evaluate::Metrics };
    "folds", folds::FoldsParams: { "metrics": folds::Metrics };
    "masks", masks::MasksParams: { "metrics": masks::Metrics };
    "partial", partial::PartialParams: { "reached": partial::Reached };
    "render", render::RenderParams: { "poses": render::Poses, "film": video::Film };
    "scenes", scenes::ScenesParams: { "scenes": scenes::Scenes };
    "surface", surface::SurfaceParams: { "surface": surface::SurfaceReport };
    "ties", ties::TiesParams: { "ties": ties::Ties };
    "train", train::TrainParams: { "metrics": train::Metrics, "setup": train::Setup, "curve": train::Curve };
    "tune", tune::TuneParams: { "params": tune::BestParams, "trials": tune::Trials, "scatter": tune::Scatter };
    "video", video::VideoParams: {};
}
