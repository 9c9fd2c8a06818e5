//! Colour maps.

/// A colour map whose lightness rises steadily, so that it is readable in gray and by the colour-blind.
///
/// Both are matplotlib's maps of the same name (CC0), reduced to ten anchors with straight lines between.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Palette {
    /// Black over red to pale yellow: uncertainty.
    Inferno,
    /// Dark blue over green to yellow: depth.
    Viridis,
}

const INFERNO: [u32; 10] = [
    0x00_0004, 0x1b_0c41, 0x4a_0c6b, 0x78_1c6d, 0xa5_2c60, 0xcf_4446, 0xed_6925, 0xfb_9b06, 0xf7_d13d,
    0xfc_ffa4,
];
const VIRIDIS: [u32; 10] = [
    0x44_0154, 0x48_2878, 0x3e_4989, 0x31_688e, 0x26_828e, 0x1f_9e89, 0x35_b779, 0x6e_ce58, 0xb5_de2b,
    0xfd_e725,
];

impl Palette {
    /// Returns the sRGB colour of a share in [0, 1]. Outside it is the colour of the nearer end. NaN is the low end.
    pub fn color(self, share: f32) -> [u8; 3] {
        let anchors = match self {
            Self::Inferno => &INFERNO,
            Self::Viridis => &VIRIDIS,
        };
        #[allow(
            clippy::manual_clamp,
            reason = "NaN becomes the low end, which clamp would let through"
        )]
        let place = share.max(0.0).min(1.0) * (anchors.len() - 1) as f32;
        let low = (place as usize).min(anchors.len() - 2);
        let weight = place - low as f32;
        let (from, to) = (channels(anchors[low]), channels(anchors[low + 1]));
        [0, 1, 2].map(|channel| (from[channel] + (to[channel] - from[channel]) * weight + 0.5) as u8)
    }
}

/// Returns the channels of 0xRRGGBB.
fn channels(rgb: u32) -> [f32; 3] {
    [16, 8, 0].map(|shift| ((rgb >> shift) & 255) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lightness_rises_steadily_from_end_to_end() {
        for palette in [Palette::Inferno, Palette::Viridis] {
            let luma = |step: u32| {
                let [red, green, blue] = palette.color(step as f32 / 64.0).map(f32::from);
                0.2126 * red + 0.7152 * green + 0.0722 * blue
            };
            for step in 0..64 {
                assert!(
                    luma(step + 1) > luma(step),
                    "{palette:?} at {step}: {}",
                    luma(step)
                );
            }
        }
    }

    #[test]
    fn values_outside_take_the_nearer_end_and_nan_the_low_one() {
        for (value, same_as) in [(-1.0, 0.0), (f32::INFINITY, 1.0), (f32::NAN, 0.0), (1e30, 1.0)] {
            assert_eq!(
                Palette::Inferno.color(value),
                Palette::Inferno.color(same_as),
                "{value}"
            );
        }
        assert_eq!(Palette::Inferno.color(1.0), [0xfc, 0xff, 0xa4]);
        assert_eq!(Palette::Viridis.color(0.0), [0x44, 0x01, 0x54]);
    }
}
