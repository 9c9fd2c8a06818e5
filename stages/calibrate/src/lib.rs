//! Photos and priors to a calibrated scene.
