//! Where along a ray a field is looked at: from where, how far, in steps of what length.

use marf_numeric::upper_median;

use super::choice::Choice;
use crate::config::MOST_HALVINGS;
use crate::distances::Depths;
use crate::frame::FAR;
use crate::{Config, View};

/// Distance of the first sample where nothing is known, half sides.
pub(super) const NEAR: f64 = 0.1;
/// Surface without sparse points on it may come this much nearer than they do.
pub(super) const NEARER: f64 = 0.5;
/// ... and reach this much farther: a ridge without texture has no points.
const FARTHER: f64 = 8.0;
/// The last steps are at most this many pixels long at their distance.
const PIXELS_A_STEP: f64 = 1.0;

pub(super) fn near(config: &Config, depths: &Result<Depths, String>) -> Choice<f64> {
    if let Some(near) = config.near {
        return Choice::said(near, "near");
    }
    let near = match depths {
        Err(why) => Choice::new(NEAR, format!("{why}: {NEAR} half sides of the box")),
        Ok(Depths { nearest, .. }) => Choice::new(
            (NEARER * nearest).clamp(1e-4, FAR),
            format!(
                "99 % of the sparse points that cameras see are farther than {nearest:.4} half sides: half of that"
            ),
        ),
    };
    match config.far {
        Some(far) if near.value >= far => Choice::new(0.5 * far, format!("half of `far`, which is {far}")),
        _ => near,
    }
}

pub(super) fn far(config: &Config, depths: &Result<Depths, String>) -> Choice<f64> {
    if let Some(far) = config.far {
        return Choice::said(far, "far");
    }
    let far = match depths {
        Err(why) => Choice::new(
            FAR,
            format!("{why}: {FAR} half sides, beyond which no cell of the finest level is resolved"),
        ),
        Ok(Depths { farthest, most, .. }) => Choice::new(
            (FARTHER * farthest).min(*most),
            format!(
                "99 % of the sparse points that cameras see are nearer than {farthest:.4} half sides: {FARTHER} times that, at most {most:.0}"
            ),
        ),
    };
    let near = near(config, depths).value;
    if far.value > near {
        return far;
    }
    Choice::new(2.0 * near, format!("twice `near`, which is {near}"))
}

/// Returns how often steps must be halved to end at the width of a pixel or less.
pub(super) fn halvings(config: &Config, views: &[View]) -> Choice<u32> {
    if let Some(halvings) = config.halvings {
        return Choice::said(halvings, "halvings");
    }
    let focal_px = upper_median(views.iter().map(|view| view.camera.fx_px)).unwrap_or_default();
    let pixels = config.cone * focal_px;
    let length = |halvings: u32| pixels * 0.5_f64.powi(halvings as i32);
    let enough = (0..MOST_HALVINGS).find(|halvings| length(*halvings) <= PIXELS_A_STEP);
    let halvings = enough.unwrap_or(MOST_HALVINGS);
    let reason = format!(
        "a step of `cone` is {pixels:.1} pixels long (focal length {focal_px:.0} px). It ends at {:.2}, the first of at most {PIXELS_A_STEP} or the {MOST_HALVINGS}th",
        length(halvings)
    );
    Choice::new(halvings, reason)
}
