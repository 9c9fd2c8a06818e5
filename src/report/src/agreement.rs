//! How far depths by pairs of photos agree with those of the retrainings at the photos that have maps: held-out ones by default.

use marf_model::RunNode;
use marf_numeric::lower_median;
use marf_scene::picture::png16::read_quantity;
use marf_schema::output::{DEPTH, MAPS, SCENE};
use maud::{Markup, html};

use super::format::count;
use super::page::Page;
use super::quality::rounded;

/// Most photos that are compared.
const MOST_PHOTOS: usize = 12;
/// Fewer pixels of an octave say nothing.
const LEAST_PIXELS: usize = 100;
/// Begin of the first octave, metres.
const FIRST_M: f64 = 0.25;
const OCTAVES: usize = 16;

/// A pixel with both distances, metres.
#[derive(Debug, Clone, Copy)]
struct Compared {
    pairs_m: f64,
    field_m: f64,
}

/// Says for each octave of distance how far the two are apart. Empty without a field of the same scene, or without metres.
pub(super) fn body(page: &Page<'_>, depth: &RunNode) -> Markup {
    let mut pixels = Vec::new();
    let mut photos = 0;
    for (view, field) in fields(page, depth).take(MOST_PHOTOS) {
        let pairs = page.bytes(depth, &format!("{DEPTH}{view}.png"));
        let pairs = pairs.ok().and_then(|bytes| Map::of_picture(&bytes));
        let found = pairs.map_or_else(Vec::new, |pairs| compared(&pairs, &field));
        photos += usize::from(!found.is_empty());
        pixels.extend(found);
    }
    let octaves = (0..OCTAVES).filter_map(|octave| words(&pixels, FIRST_M * f64::from(1_u32 << octave)));
    let octaves: Vec<String> = octaves.collect();
    html! {
        @if !octaves.is_empty() {
            p {
                "At the pixels of " (count(photos, "photo")) " that have both, pairs of photos and the retrainings' mean agree within "
                (octaves.join(", ")) ". These are medians."
            }
        }
    }
}

/// Returns the maps of depth that a bootstrap made of the scene, by the name of their view.
fn fields<'p>(page: &'p Page<'_>, depth: &RunNode) -> impl Iterator<Item = (&'p str, Map)> {
    let scene = depth.run.inputs.get(SCENE);
    let of_scene = move |node: &&RunNode| scene.is_some() && node.run.inputs.get(SCENE) == scene;
    let node = page.with_outputs_under(MAPS).filter(of_scene).last();
    let names = node
        .into_iter()
        .flat_map(|node| node.outputs_under(MAPS).map(move |(name, _)| (node, name)));
    names.filter_map(|(node, name)| {
        let view = name.strip_suffix("-depth.npy")?;
        let bytes = page.bytes(node, &format!("{MAPS}{name}")).ok()?;
        Some((view, Map::decode(&bytes)?))
    })
}

/// Distances along the rays of pixels, metres, not above 0 where there is none.
struct Map {
    width: usize,
    values: Vec<f32>,
}

impl Map {
    /// Reads a picture of distances. `None` if the bytes are anything else.
    fn of_picture(bytes: &[u8]) -> Option<Self> {
        let (width, _, values) = read_quantity(bytes, "depth")?;
        let width = width as usize;
        Some(Self { width, values })
    }

    fn rows(&self) -> usize {
        self.values.len() / self.width
    }

    /// Reads an array of two dimensions as `bootstrap` writes it: a header of ASCII, then f32. `None` if the bytes are anything else.
    fn decode(bytes: &[u8]) -> Option<Self> {
        let length = usize::from(u16::from_le_bytes([*bytes.get(8)?, *bytes.get(9)?]));
        let header = std::str::from_utf8(bytes.get(10..10 + length)?).ok()?;
        let (_, shape) = header.split_once("'shape': (")?;
        let width = shape
            .split(", ")
            .nth(1)?
            .trim_end_matches(|c: char| !c.is_ascii_digit());
        let values = bytes[10 + length..].as_chunks::<4>().0.iter();
        Some(Self {
            width: width.parse().ok().filter(|width| *width > 0)?,
            values: values.map(|value| f32::from_le_bytes(*value)).collect(),
        })
    }
}

/// Returns the pixels of the pairs that have a distance in both maps, whose sizes may differ.
fn compared(pairs: &Map, field: &Map) -> Vec<Compared> {
    let pixel = |index: usize| {
        let pairs_m = pairs.values[index];
        let (column, row) = (index % pairs.width, index / pairs.width);
        let at = (row * field.rows() / pairs.rows()) * field.width + column * field.width / pairs.width;
        let field_m = field.values.get(at).copied().unwrap_or(0.0);
        let both = pairs_m > 0.0 && field_m > 0.0;
        both.then_some(Compared {
            pairs_m: f64::from(pairs_m),
            field_m: f64::from(field_m),
        })
    };
    (0..pairs.values.len()).filter_map(pixel).collect()
}

/// Says how far pixels of the octave from here on are apart in the median. `None` of few.
fn words(pixels: &[Compared], from_m: f64) -> Option<String> {
    let octave = from_m..2.0 * from_m;
    let apart = pixels.iter().filter(|one| octave.contains(&one.pairs_m));
    let apart: Vec<f64> = apart.map(|one| (one.pairs_m - one.field_m).abs()).collect();
    let median = lower_median(apart.iter().copied()).filter(|_| apart.len() >= LEAST_PIXELS)?;
    let median = if median < 1.0 {
        format!("{} cm", rounded(100.0 * median))
    } else {
        format!("{} m", rounded(median))
    };
    let [low, high] = [from_m, 2.0 * from_m].map(rounded);
    Some(format!("{median} at {low} to {high} m"))
}

#[cfg(test)]
mod tests {
    use marf_engine::NodeInput;
    use marf_scene::picture::png16;

    use super::*;
    use crate::fixture::{Store, giving, node};
    use crate::media::Media;

    /// An array of one row as `bootstrap` writes it.
    fn array<const N: usize>(values: [f32; N]) -> Vec<u8> {
        let header = format!("{{'descr': '<f4', 'fortran_order': False, 'shape': (1, {N},), }}\n");
        let mut bytes = b"\x93NUMPY\x01\x00".to_vec();
        bytes.extend((header.len() as u16).to_le_bytes());
        bytes.extend(header.as_bytes());
        bytes.extend(values.into_iter().flat_map(f32::to_le_bytes));
        bytes
    }

    /// A row of 200 pixels, 5 m away by the pairs and 5.03 m by the field.
    #[test]
    fn the_report_says_how_far_pairs_and_the_field_agree_in_one_scene() {
        let said = |is_of_scene: bool| {
            let mut store = Store::default();
            let [scene, other] = [b"scene", b"other"].map(|bytes| store.put(bytes));
            let of_scene = |mut node: RunNode, digest| {
                let input = NodeInput {
                    digest,
                    made_by: None,
                };
                node.run.inputs.insert(SCENE.to_owned(), input);
                node
            };
            let picture = png16::depth(200, 1, &[2.5; 200], Some(2.0)).unwrap();
            let depth = giving(node("depth", &[]), [("depth/v.png", store.put(&picture))]);
            let maps = [("maps/v-depth.npy", store.put(&array([5.03; 200])))];
            let maps = of_scene(
                giving(node("bootstrap", &[]), maps),
                if is_of_scene { scene } else { other },
            );
            let depth = of_scene(depth, scene);
            store.with_report(&[maps, depth.clone()], |report| {
                body(&Page::new(report, &Media::Embedded), &depth).into_string()
            })
        };
        let expected = "pixels of 1 photo that have both, pairs of photos and the retrainings' mean agree within 3 cm at 4 to 8 m. These are";
        assert!(said(true).contains(expected), "{}", said(true));
        assert_eq!(said(false), "");
    }

    /// 200 pixels at 5 m, whose field is 2 cm nearer or 4 cm farther, and 10 at 20 m, which are too few.
    #[test]
    fn an_octave_has_the_median_of_its_pixels() {
        let pixel = |index: u32| Compared {
            pairs_m: if index < 200 { 5.0 } else { 20.0 },
            field_m: if index.is_multiple_of(4) { 5.04 } else { 4.98 },
        };
        let pixels: [Compared; 210] = std::array::from_fn(|index| pixel(index as u32));
        assert_eq!(words(&pixels, 4.0).unwrap(), "2 cm at 4 to 8 m");
        assert_eq!(words(&pixels, 16.0), None);
        let far = pixels.map(|one| Compared { field_m: 6.5, ..one });
        assert_eq!(words(&far, 4.0).unwrap(), "1.5 m at 4 to 8 m");
        assert_eq!(words(&[], 4.0), None);
    }

    #[test]
    fn maps_of_other_sizes_are_compared_where_they_show_the_same() {
        let bytes = array([3.0, -1.0]);
        let field = Map::decode(&bytes).unwrap();
        let pairs = Map {
            width: 4,
            values: vec![2.0, 0.0, 5.0, 5.0, 2.5, 0.0, 0.0, 0.0],
        };
        let found = compared(&pairs, &field);
        let pairs: Vec<f64> = found.iter().map(|one| one.pairs_m).collect();
        assert_eq!((pairs, found[0].field_m), (vec![2.0, 2.5], 3.0));
        for cut in 0..bytes.len() - 8 {
            assert!(Map::decode(&bytes[..cut]).is_none(), "{cut}");
        }
    }
}
