//! The pose that a transforms.json writes as a matrix.

use marf_scene::Pose;
use nalgebra::{Matrix3, Vector3};

use super::cameras::ImportError;
use super::json_node::JsonNode;

/// A rotation may be this far from orthonormal: files with six digits are 1e-6 off, a shear is not.
const ROTATION_TOLERANCE: f64 = 1e-3;
/// Rotations closer than this to orthonormal are taken as they are.
const ROTATION_EXACT: f64 = 1e-14;
/// The last row of every rigid transform.
const LAST_ROW: [f64; 4] = [0.0, 0.0, 0.0, 1.0];

/// Returns the pose of a transform matrix.
pub(super) fn pose(node: &JsonNode<'_>) -> Result<Pose, ImportError> {
    let rows = node.items()?;
    // Without the last row the matrix says the same.
    if !(3..=4).contains(&rows.len()) {
        return Err(node.error(format!(
            "{} rows, a transform has 3 or 4 of 4 numbers",
            rows.len()
        )));
    }
    let mut matrix = [[0.0; 4]; 4];
    matrix[3] = LAST_ROW;
    for (row, numbers) in matrix.iter_mut().zip(&rows) {
        let values = numbers.items()?;
        if values.len() != 4 {
            return Err(numbers.error(format!("{} numbers, a row of a transform has 4", values.len())));
        }
        for (number, value) in row.iter_mut().zip(&values) {
            *number = value.number()?;
        }
    }
    if matrix[3]
        .iter()
        .zip(LAST_ROW)
        .any(|(ours, rigid)| (ours - rigid).abs() > 1e-6)
    {
        return Err(node.error(format!(
            "the last row is {:?}, a rigid transform has 0, 0, 0, 1",
            matrix[3]
        )));
    }
    let world_from_gl = Matrix3::from_fn(|row, column| matrix[row][column]);
    let centre = Vector3::from_fn(|row, _| matrix[row][3]);
    let rotation = rotation(&world_from_gl).map_err(|problem| node.error(problem))?;
    let cam_from_gl = Matrix3::from_diagonal(&Vector3::new(1.0, -1.0, -1.0));
    let cam_from_world = cam_from_gl * rotation.transpose();
    Ok(Pose {
        rotation: cam_from_world,
        translation: -(cam_from_world * centre),
    })
}

/// Divides out a uniform scale and makes rounded digits orthonormal again.
pub(super) fn rotation(matrix: &Matrix3<f64>) -> Result<Matrix3<f64>, String> {
    let determinant = matrix.determinant();
    if !determinant.is_normal() || determinant < 0.0 {
        return Err(format!(
            "its rotation has the determinant {determinant}: singular or mirrored"
        ));
    }
    let length = [0, 1, 2].map(|column| matrix.column(column).norm());
    let scale = (length[0] + length[1] + length[2]) / 3.0;
    let defect = |r: &Matrix3<f64>| (r.transpose() * r - Matrix3::identity()).abs().max();
    let mut rotation = if (scale - 1.0).abs() < ROTATION_EXACT {
        *matrix
    } else {
        matrix / scale
    };
    let off = defect(&rotation);
    if off.is_nan() || off > ROTATION_TOLERANCE {
        return Err(format!(
            "its columns are not a rotation: lengths {length:?}, off by {off:.2e}, at most {ROTATION_TOLERANCE:e}"
        ));
    }
    if off > ROTATION_EXACT {
        // Each step of (R + R⁻ᵀ) / 2 squares the defect: 1e-3, 1e-6, 1e-12, done.
        for _ in 0..4 {
            let inverse = rotation.try_inverse().ok_or("its rotation cannot be inverted")?;
            rotation = (rotation + inverse.transpose()) / 2.0;
        }
    }
    Ok(rotation)
}
