//! Everything known when the mapping is done.

use marf_sfm::mapper::{Intruders, MapperInput, Model};
use marf_sfm::metric::LabelAgreement;
use marf_sfm::view_graph::ComparedPair;

use super::photo_features::PhotoFeatures;
use crate::photos::InputPhoto;

/// The models with all they were made from.
pub(super) struct Reconstruction<'a> {
    pub items: &'a [InputPhoto],
    pub features: &'a [PhotoFeatures],
    pub compared: &'a [ComparedPair],
    pub input: &'a MapperInput<'a>,
    pub models: &'a [Model],
    /// For each model: what hides the scene in its photos.
    pub intruders: &'a [Intruders],
    /// For each model that is in the frame of its labels: what the photos say of them.
    pub metric: &'a [Option<LabelAgreement>],
    /// The site of the labels, if they name one.
    pub site: Option<i64>,
}
