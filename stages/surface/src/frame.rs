//! Units and axes of exports, as far as the scene knows them.

use marf_scene::{Scene, SiteFrame};
use nalgebra::{Matrix3, Vector3};

use crate::SurfaceError;

/// An axis counts as up or down within this cosine.
const ALONG_AXIS: f64 = 0.999_999;

/// Unit and up direction of a scene.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ExportFrame {
    /// Metres a world unit. `None` if the scene has no scale.
    pub metres_per_unit: Option<f64>,
    /// Unit vector of the world that points up. `None` if the scene does not know up.
    pub up: Option<Vector3<f64>>,
    /// Place of the world in a site: maps are in that frame, so that those of its scenes fit each other.
    pub site: Option<SiteFrame>,
}

/// Axes of a map: right-handed, unit vectors of the world.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct MapAxes {
    /// To the right on the map.
    pub right: Vector3<f64>,
    /// To the top of the map.
    pub top: Vector3<f64>,
    /// Towards the reader: up.
    pub up: Vector3<f64>,
}

impl MapAxes {
    /// Returns the place on the map with the height, in the unit of the position.
    pub fn place(&self, position: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(
            self.right.dot(position),
            self.top.dot(position),
            self.up.dot(position),
        )
    }
}

impl ExportFrame {
    /// Returns the frame of a scene.
    pub fn new(scene: &Scene) -> Self {
        let length = |up: Vector3<f64>| {
            up.try_normalize(1e-9)
                .filter(|up| up.iter().all(|x| x.is_finite()))
        };
        Self {
            metres_per_unit: scene
                .metres_per_unit
                .filter(|metres| metres.is_finite() && *metres > 0.0),
            up: scene.up.and_then(|up| length(Vector3::from(up))),
            site: scene.site,
        }
    }

    /// Returns the factor from world units to the unit of exports: metres where there is a scale, else world units.
    pub fn scale(&self) -> f64 {
        self.metres_per_unit.unwrap_or(1.0)
    }

    /// Returns the world's origin in the frame of maps, metres: that of the site, or the world itself.
    pub fn origin_m(&self) -> Vector3<f64> {
        self.site.map_or_else(Vector3::zeros, |site| site.origin_m.into())
    }

    /// Returns whose origin coordinates of maps count from, in words.
    pub fn origin_words(&self) -> String {
        match self.site {
            Some(site) => format!("site {}", site.site),
            None => "the world of the scene".to_owned(),
        }
    }

    /// Returns the unit of exports in words.
    pub fn unit(&self) -> &'static str {
        match self.metres_per_unit {
            Some(_) => "metres",
            None => "units of the scene, whose scale is not known",
        }
    }

    /// Returns the axes of a map. In a site frame of Mars (z down, x north, y east) north is at the top. In a
    /// frame with z up, y is at the top. In any other frame the top is the horizontal part of x, or of y
    /// where x is steeper.
    pub fn map_axes(&self) -> Option<MapAxes> {
        let up = self.up?;
        let guide = if up.z > ALONG_AXIS {
            Vector3::y()
        } else if up.x.abs() <= up.y.abs() || up.z < -ALONG_AXIS {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let top = (guide - up * up.dot(&guide)).try_normalize(1e-9)?;
        Some(MapAxes {
            right: top.cross(&up),
            top,
            up,
        })
    }

    /// Returns the axes of a map and metres a unit.
    ///
    /// # Errors
    /// [`SurfaceError::Refused`] for a scene without scale or up: neither is guessed.
    pub fn metric_map(&self, what: &'static str) -> Result<(MapAxes, f64), SurfaceError> {
        let refused = |why: &str| SurfaceError::Refused {
            what,
            why: why.to_owned(),
        };
        let metres = self
            .metres_per_unit
            .ok_or_else(|| refused("the scene has no scale, so nothing is known in metres"))?;
        let axes = self
            .map_axes()
            .ok_or_else(|| refused("the scene does not know where up is"))?;
        Ok((axes, metres))
    }

    /// Returns the rotation from the world to axes with y up (glTF: x right, y up, z towards the viewer).
    /// Without a known up it keeps the axes of the scene.
    pub fn y_up(&self) -> Matrix3<f64> {
        match self.map_axes() {
            Some(axes) => {
                Matrix3::from_rows(&[axes.right.transpose(), axes.up.transpose(), -axes.top.transpose()])
            }
            None => Matrix3::identity(),
        }
    }

    /// Describes the axes of files in the scene's own frame.
    pub fn up_words(&self) -> String {
        let up = match self.up {
            Some(up) => format!("up is ({} {} {})", up.x, up.y, up.z),
            None => "up is not known".to_owned(),
        };
        match self.site {
            Some(SiteFrame {
                site,
                origin_m: [x, y, z],
            }) => {
                format!("{up}; in the frame of site {site} (metres) the origin is ({x} {y} {z})")
            }
            None => up,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(up: [f64; 3]) -> ExportFrame {
        ExportFrame::new(&Scene {
            up: Some(up),
            metres_per_unit: Some(2.0),
            ..Scene::default()
        })
    }

    #[test]
    fn a_site_frame_has_north_at_the_top_and_east_at_the_right() {
        let axes = frame([0.0, 0.0, -1.0]).map_axes().unwrap();
        assert_eq!((axes.top, axes.right), (Vector3::x(), Vector3::y()));
        let axes = frame([0.0, 0.0, 3.0]).map_axes().unwrap();
        assert_eq!((axes.top, axes.right), (Vector3::y(), Vector3::x()));
    }

    #[test]
    fn axes_are_right_handed_whatever_is_up() {
        for up in [
            [1.0, 0.0, 0.0],
            [0.0, -2.0, 0.0],
            [0.3, 0.4, -0.9],
            [0.0, 0.0, 1.0],
            [-0.9, 0.1, 0.1],
        ] {
            let frame = frame(up);
            let rotation = frame.y_up();
            assert!((rotation.determinant() - 1.0).abs() < 1e-12, "{up:?}");
            let turned = rotation * frame.up.unwrap();
            assert!((turned - Vector3::y()).norm() < 1e-12, "{up:?}: {turned}");
        }
    }

    #[test]
    fn a_scene_without_scale_or_up_has_no_metric_map_and_says_which() {
        let bare = ExportFrame::new(&Scene::default());
        let why = bare.metric_map("the height map").unwrap_err().to_string();
        assert!(why.contains("no scale"), "{why}");
        let scaled = ExportFrame {
            metres_per_unit: Some(1.0),
            ..bare
        };
        let why = scaled.metric_map("the height map").unwrap_err().to_string();
        assert!(why.contains("where up is"), "{why}");
        for up in [[0.0; 3], [f64::NAN, 0.0, 1.0]] {
            assert_eq!(frame(up).up, None, "{up:?}");
        }
        assert_eq!(bare.y_up(), Matrix3::identity());
    }
}
