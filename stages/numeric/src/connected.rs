//! Connected parts of pictures and of lists of pairs.

/// Calls `visit` with each part of a picture: the pixels that are in and are joined by their sides, directly or through others.
///
/// Parts come in the order of their first pixels, row by row, and the pixels of a part from its first one outwards.
///
/// - `is_in`: by rows of `width` pixels.
/// - `is_joined`: whether two neighbours that are in belong together.
pub fn visit_parts(
    is_in: &[bool],
    width: usize,
    is_joined: impl Fn(usize, usize) -> bool,
    mut visit: impl FnMut(&[usize]),
) {
    let mut left = is_in.to_vec();
    let mut part = Vec::new();
    for start in 0..left.len() {
        if !std::mem::take(&mut left[start]) {
            continue;
        }
        part.clear();
        part.push(start);
        let mut next = 0;
        while let Some(&pixel) = part.get(next) {
            next += 1;
            let column = pixel % width;
            let sides = [
                (column > 0).then(|| pixel - 1),
                (column + 1 < width).then_some(pixel + 1),
                pixel.checked_sub(width),
                Some(pixel + width),
            ];
            for side in sides.into_iter().flatten() {
                if left.get(side) == Some(&true) && is_joined(pixel, side) {
                    left[side] = false;
                    part.push(side);
                }
            }
        }
        visit(&part);
    }
}

/// Returns for each number below `count` the lowest number that pairs join it to, directly or through others.
pub fn lowest_joined(count: usize, pairs: impl IntoIterator<Item = [usize; 2]>) -> Vec<usize> {
    let mut parent: Vec<usize> = (0..count).collect();
    for pair in pairs {
        let [a, b] = pair.map(|number| root(&mut parent, number));
        parent[a.max(b)] = a.min(b);
    }
    (0..count).map(|number| root(&mut parent, number)).collect()
}

fn root(parent: &mut [usize], mut number: usize) -> usize {
    while parent[number] != number {
        // Halves the way for the next look.
        parent[number] = parent[parent[number]];
        number = parent[number];
    }
    number
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parts(is_in: &[u8], width: usize) -> Vec<Vec<usize>> {
        let is_in: Vec<bool> = is_in.iter().map(|one| *one == 1).collect();
        let mut parts = Vec::new();
        visit_parts(&is_in, width, |_, _| true, |part| parts.push(part.to_vec()));
        parts
    }

    #[test]
    fn parts_are_joined_by_sides_and_not_by_corners_or_around_the_rim() {
        let picture = [
            1, 1, 0, 1, //
            0, 1, 0, 0, //
            1, 0, 1, 1,
        ];
        assert_eq!(
            parts(&picture, 4),
            [vec![0, 1, 5], vec![3], vec![8], vec![10, 11]]
        );
        assert_eq!(parts(&[1, 1, 1], 1), [[0, 1, 2]]);
        assert!(parts(&[], 0).is_empty() && parts(&[0; 6], 3).is_empty());
    }

    #[test]
    fn neighbours_that_do_not_belong_together_are_two_parts() {
        let values = [1, 1, 5, 6, 6, 9];
        let mut sizes = Vec::new();
        visit_parts(
            &[true; 6],
            6,
            |a, b| i32::abs_diff(values[a], values[b]) < 2,
            |part| sizes.push(part.len()),
        );
        assert_eq!(sizes, [2, 3, 1]);
    }

    #[test]
    fn numbers_are_joined_through_others_in_any_order() {
        assert_eq!(lowest_joined(6, [[5, 3], [1, 4], [3, 1]]), [0, 1, 2, 1, 1, 1]);
        assert_eq!(lowest_joined(3, [[1, 1]]), [0, 1, 2]);
        assert!(lowest_joined(0, []).is_empty());
    }
}
