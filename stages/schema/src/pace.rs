//! `pace`: how many steps a time budget buys on this machine.

use marf_field::{Device, Overrides, Quality};
use marf_stage::{Document, ParamError, Params};
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use crate::{
    check_field, check_scale,
    train::{Budget, Fit, Holdout, Memory, TrainParams},
};

/// Parameters of `pace`: those of `train` that decide how long a step takes.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(deny_unknown_fields)]
pub struct PaceParams {
    /// Time to train for (`60s`, `5m`).
    pub budget: Budget,
    /// Size of the photos and of the field.
    #[serde(default)]
    pub quality: Quality,
    /// Whole factor by which photos are shrunk; absent: the least that brings them to the size of `quality`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scale: Option<u32>,
    /// Memory that the training may take.
    #[serde(default)]
    pub memory: Memory,
    /// Photos that are kept away from training.
    #[serde(default)]
    pub holdout: Holdout,
    /// What decides how large the field is.
    #[serde(default)]
    pub fit: Fit,
    /// Keys of the field; they win over those of the input `params`.
    #[serde(default)]
    pub field: Overrides,
    /// Which processor trains and renders: `auto` (a GPU where there is one, never a software adapter), `cpu`, `gpu`,
    /// or `gpu:NAME` for the adapter whose name holds NAME. Only what was opened is in the key.
    #[serde(default)]
    pub device: Device,
}

impl PaceParams {
    /// Returns what `train` asks to be paced, if it has a budget.
    pub fn of(train: &TrainParams) -> Option<Self> {
        Some(Self {
            budget: train.budget?,
            quality: train.quality,
            scale: train.scale,
            memory: train.memory,
            holdout: train.holdout,
            fit: train.fit,
            field: train.field.clone(),
            device: train.device.clone(),
        })
    }

    /// Checks what can be checked without a scene.
    ///
    /// # Errors
    /// Names the key that is out of range.
    pub fn check(&self) -> Result<(), ParamError> {
        check_scale(self.scale)?;
        check_field(self.quality, self.fit, &self.field)
    }
}

impl Params for PaceParams {
    const STAGE: &'static str = "pace";
}

/// Output `steps` of `pace`: optimiser steps that the budget buys.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(transparent)]
pub struct Steps(pub u64);

impl Document for Steps {
    const STAGE: &'static str = PaceParams::STAGE;
    const OUTPUT: &'static str = "steps";
}
