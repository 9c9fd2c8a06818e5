//! What can be wrong with the camera of a label before it is a model.

use marf_scene::EntrancePupil;

/// A camera that a label does not describe in full.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum CameraError {
    /// A number that is missing, not finite or a sentinel.
    #[error("{0} is missing or no finite number")]
    Number(&'static str),
    /// A type of CAHVORE that does not exist.
    #[error("CAHVORE type {0} is not 1, 2 or 3")]
    EntranceType(i64),
}

/// Returns the entrance pupil of a CAHVORE, by the model's type and its parameter.
///
/// # Errors
/// [`CameraError::EntranceType`].
pub fn entrance(terms: [f64; 3], kind: i64, parameter: f64) -> Result<EntrancePupil, CameraError> {
    let linearity = match kind {
        1 => 1.0,
        2 => 0.0,
        3 => parameter,
        other => return Err(CameraError::EntranceType(other)),
    };
    Ok(EntrancePupil { terms, linearity })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_type_of_a_cahvore_decides_its_linearity() {
        for (kind, parameter, linearity) in [(1, 0.3, 1.0), (2, 0.3, 0.0), (3, 0.6, 0.6)] {
            let pupil = entrance([0.0; 3], kind, parameter).unwrap();
            assert_eq!(pupil.linearity, linearity, "type {kind}");
        }
        let error = entrance([0.0; 3], 4, 0.0).unwrap_err().to_string();
        assert!(error.contains("type 4"), "{error}");
    }
}
