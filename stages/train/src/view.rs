//! Renders of whole views, in bands that are kept while a large one is under way.

use marf_cache::Digest;
use marf_field::{Field, Render, render_in_bands};
use marf_scene::{Camera, Pose};
use marf_stage::{Ctx, StageError};

use crate::{checkpoint::Journal, error::field_failed};

/// Renders a view. `of` identifies field and viewpoint.
pub(crate) fn render_view(
    ctx: &Ctx<'_>,
    of: Digest,
    field: &Field,
    camera: &Camera,
    cam_from_world: &Pose,
) -> Result<Render, StageError> {
    let mut bands = Journal::new(ctx, "bands", of);
    render_in_bands(field, camera, cam_from_world, |rows, render| {
        let height = rows.end - rows.start;
        bands.piece(
            |bytes| unpack(bytes, camera.width, height),
            || {
                let band = render().map_err(field_failed)?;
                let bytes = pack(&band);
                Ok((band, bytes))
            },
        )
    })
}

/// Colours, opacities and depths, f32 LE.
pub(crate) fn pack(render: &Render) -> Vec<u8> {
    let numbers = render.rgb.as_flattened().iter();
    let numbers = numbers.chain(&render.opacity).chain(&render.depth);
    numbers.flat_map(|number| number.to_le_bytes()).collect()
}

/// Reads the bytes of [`pack`] for a render of that size. `None` if they are anything else.
pub(crate) fn unpack(bytes: &[u8], width: u32, height: u32) -> Option<Render> {
    let numbers = floats(bytes)?;
    let pixels = width as usize * height as usize;
    let (rgb, rest) = numbers.split_at_checked(3 * pixels)?;
    let (opacity, depth) = rest.split_at_checked(pixels)?;
    (depth.len() == pixels).then(|| Render {
        width,
        height,
        rgb: rgb.as_chunks::<3>().0.to_vec(),
        opacity: opacity.to_vec(),
        depth: depth.to_vec(),
    })
}

/// Reads f32 LE. `None` if a number is incomplete.
pub(crate) fn floats(bytes: &[u8]) -> Option<Vec<f32>> {
    let (numbers, rest) = bytes.as_chunks::<4>();
    rest.is_empty()
        .then(|| numbers.iter().map(|number| f32::from_le_bytes(*number)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_render_comes_back_to_the_bit_and_one_of_another_size_does_not() {
        let render = Render {
            width: 2,
            height: 1,
            rgb: vec![[0.1, f32::MIN_POSITIVE, 1.0], [-0.0, 0.5, 1e30]],
            opacity: vec![0.25, 1.0],
            depth: vec![3.5, 0.0],
        };
        let bytes = pack(&render);
        assert_eq!(unpack(&bytes, 2, 1), Some(render));
        for (bytes, width) in [(&bytes[..], 1), (&bytes[..], 3), (&bytes[..39], 2), (&[][..], 2)] {
            assert_eq!(unpack(bytes, width, 1), None, "{} bytes, {width}", bytes.len());
        }
    }
}
