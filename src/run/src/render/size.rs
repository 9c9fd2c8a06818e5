//! The size of the pictures of a rendering.

use crate::error::Error;

/// The size as a user gives it.
#[derive(Debug, Clone, Default)]
pub struct SizeRequest {
    /// Width, pixels.
    pub width: Option<u32>,
    /// Height, pixels.
    pub height: Option<u32>,
    /// Size as a factor of the natural one.
    pub scale: Option<f64>,
}

/// The size as keys of a node. None uses the default of the node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Size {
    /// Width, pixels.
    pub width: Option<u32>,
    /// Height, pixels.
    pub height: Option<u32>,
}

impl SizeRequest {
    /// Returns width and height, or None where the node's default applies.
    ///
    /// - `natural_px`: width and height at factor 1.
    ///
    /// # Errors
    /// A factor that leaves no pixel, or that is not a number.
    pub fn keys(&self, natural_px: [u32; 2], default_width: Option<u32>) -> Result<Size, Error> {
        let natural = natural_px.map(f64::from);
        let (width, height) = match (self.width, self.height, self.scale) {
            (None, None, None) => (default_width, None),
            (None, None, Some(scale)) => (Some(scaled(natural_px[0], scale)?), None),
            (None, Some(asked), _) => {
                let width = (f64::from(asked) * natural[0] / natural[1].max(1.0)).round() as u32;
                (Some(width.max(1)), Some(asked))
            }
            (width, height, _) => (width, height),
        };
        Ok(Size { width, height })
    }
}

fn scaled(width: u32, scale: f64) -> Result<u32, Error> {
    let scaled = (f64::from(width) * scale).round();
    if scaled >= 1.0 && scaled <= f64::from(u32::MAX) {
        return Ok(scaled as u32);
    }
    Err(Error::usage(format!(
        "--scale {scale}: pictures of {width} pixels would be {scaled} wide. Take a factor above 0, e.g. 0.5"
    )))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_follows_from_what_is_given() {
        let size = |width, height, scale| {
            let request = SizeRequest { width, height, scale };
            let size = request.keys([1440, 1920], None).unwrap();
            (size.width, size.height)
        };
        assert_eq!(size(None, None, None), (None, None));
        assert_eq!(size(Some(300), None, None), (Some(300), None));
        assert_eq!(size(Some(300), Some(200), None), (Some(300), Some(200)));
        assert_eq!(size(None, Some(400), None), (Some(300), Some(400)));
        assert_eq!(size(None, None, Some(0.25)), (Some(360), None));
        // 0 is refused where all numbers of a node are.
        assert_eq!(size(None, Some(0), None), (Some(1), Some(0)));
        let default = SizeRequest::default().keys([640, 480], Some(640)).unwrap();
        assert_eq!((default.width, default.height), (Some(640), None));
    }

    #[test]
    fn a_factor_that_leaves_no_pixel_is_refused_with_the_way_out() {
        for scale in [0.0, -1.0, 1e-9, f64::NAN, f64::INFINITY] {
            let request = SizeRequest {
                scale: Some(scale),
                ..SizeRequest::default()
            };
            let error = request.keys([640, 480], None).unwrap_err();
            assert!(
                error.message().contains("Take a factor above 0"),
                "{scale}: {error:?}"
            );
        }
    }
}
