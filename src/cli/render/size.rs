//! The size of the pictures of `marf render`.

use clap::Args;

use crate::cli::error::CliError;

/// Options of the size.
#[derive(Debug, Clone, Default, Args)]
pub struct SizeArgs {
    /// Width of a picture, pixels [default: 640; that of the first bookmark for a FILE]
    #[arg(long, value_name = "PIXELS", conflicts_with = "scale")]
    pub width: Option<u32>,
    /// Height of a picture, pixels [default: as the photos or bookmarks ask for]; beside --width more or less is seen above and below
    #[arg(long, value_name = "PIXELS", conflicts_with = "scale")]
    pub height: Option<u32>,
    /// Size as a factor of that of the photos, or of the first bookmark, e.g. 0.5
    #[arg(long, value_name = "FACTOR")]
    pub scale: Option<f64>,
}

impl SizeArgs {
    /// Returns width and height, as far as they are not what the node takes by itself; `natural`: the size at factor 1.
    ///
    /// # Errors
    /// A factor that leaves no pixel, or that is none.
    pub fn of(
        &self,
        natural: (u32, u32),
        default_width: Option<u32>,
    ) -> Result<(Option<u32>, Option<u32>), CliError> {
        let (width, height) = (f64::from(natural.0), f64::from(natural.1).max(1.0));
        Ok(match (self.width, self.height, self.scale) {
            (None, None, None) => (default_width, None),
            (None, None, Some(scale)) => (Some(scaled(natural.0, scale)?), None),
            (None, Some(asked), _) => {
                let width = (f64::from(asked) * width / height).round() as u32;
                (Some(width.max(1)), Some(asked))
            }
            (width, height, _) => (width, height),
        })
    }
}

fn scaled(width: u32, scale: f64) -> Result<u32, CliError> {
    let scaled = (f64::from(width) * scale).round();
    match scaled >= 1.0 && scaled <= f64::from(u32::MAX) {
        true => Ok(scaled as u32),
        false => Err(CliError::usage(format!(
            "--scale {scale}: pictures of {width} pixels would be {scaled} wide; take a factor above 0, e.g. 0.5"
        ))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_size_follows_from_what_is_given() {
        let of = |width, height, scale| SizeArgs { width, height, scale }.of((1440, 1920), None).unwrap();
        assert_eq!(of(None, None, None), (None, None));
        assert_eq!(of(Some(300), None, None), (Some(300), None));
        assert_eq!(of(Some(300), Some(200), None), (Some(300), Some(200)));
        assert_eq!(of(None, Some(400), None), (Some(300), Some(400)));
        assert_eq!(of(None, None, Some(0.25)), (Some(360), None));
        // 0 is refused where all numbers of a node are.
        assert_eq!(of(None, Some(0), None), (Some(1), Some(0)));
        assert_eq!(
            SizeArgs::default().of((640, 480), Some(640)).unwrap(),
            (Some(640), None)
        );
    }

    #[test]
    fn a_factor_that_leaves_no_pixel_is_refused_with_the_way_out() {
        for scale in [0.0, -1.0, 1e-9, f64::NAN, f64::INFINITY] {
            let args = SizeArgs {
                scale: Some(scale),
                ..SizeArgs::default()
            };
            let error = args.of((640, 480), None).unwrap_err();
            assert!(
                error.message().contains("take a factor above 0"),
                "{scale}: {error:?}"
            );
        }
    }
}
