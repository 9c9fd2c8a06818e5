//! The frame of each scene: that of its site by labels, else that of a scene it is tied to.

use std::collections::BTreeMap;

use marf_schema::ties::{self, By, TiedScene};
use marf_sfm::align::Similarity;

use super::world::World;

/// Relative pose of two scenes: their indices, the first world from the second, and the number of points that agree.
pub(super) type Link = ([usize; 2], Similarity, u32);

/// Returns the frame of each scene. The frame of a scene with a site is the site. Every other scene takes the frame of the scene that it
/// shares most points with, of those that have one, the strongest tie first. Where no tie leads to a site, the frame is the world of the
/// scene with most photos.
pub(super) fn common_frames(worlds: &[World], links: &[Link]) -> Vec<TiedScene> {
    let mut placed: BTreeMap<usize, TiedScene> = BTreeMap::new();
    for (index, world) in worlds.iter().enumerate() {
        if let Some((site, frame)) = world.site_from_world() {
            placed.insert(index, alone(world, format!("site {site}"), By::Labels, &frame));
        }
    }
    let mut rest: Vec<usize> = (0..worlds.len()).collect();
    rest.sort_by_key(|&index| (std::cmp::Reverse(worlds[index].scene.frames.len()), index));
    spread(worlds, links, &mut placed);
    for index in rest {
        if placed.contains_key(&index) {
            continue;
        }
        let world = &worlds[index];
        placed.insert(
            index,
            alone(world, world.name.clone(), By::Itself, &Similarity::identity()),
        );
        spread(worlds, links, &mut placed);
    }
    placed.into_values().collect()
}

fn alone(world: &World, frame: String, by: By, frame_from_world: &Similarity) -> TiedScene {
    TiedScene {
        name: world.name.clone(),
        frame,
        by,
        through: Vec::new(),
        frame_from_world: stored(frame_from_world),
    }
}

/// Places all scenes that ties lead to from those that have a frame, over the strongest tie first.
fn spread(worlds: &[World], links: &[Link], placed: &mut BTreeMap<usize, TiedScene>) {
    let is_open = |link: &&Link, placed: &BTreeMap<usize, TiedScene>| {
        link.0.iter().filter(|index| placed.contains_key(index)).count() == 1
    };
    while let Some(([first, second], similarity, _)) = links
        .iter()
        .filter(|link| is_open(link, placed))
        .max_by_key(|(pair, _, points)| (*points, std::cmp::Reverse(*pair)))
    {
        // The world of the scene that has a frame, from the world of the one that gets it.
        let (from, to, known_from_new) = if placed.contains_key(first) {
            (*first, *second, similarity.clone())
        } else {
            (*second, *first, similarity.inverse())
        };
        let Some(known) = placed.get(&from) else { break };
        let frame_from_world = restored(&known.frame_from_world).after(&known_from_new);
        let mut through = known.through.clone();
        through.push(known.name.clone());
        let tied = TiedScene {
            name: worlds[to].name.clone(),
            frame: known.frame.clone(),
            by: By::Overlap,
            through,
            frame_from_world: stored(&frame_from_world),
        };
        placed.insert(to, tied);
    }
}

/// Returns a similarity as documents have it.
pub(super) fn stored(similarity: &Similarity) -> ties::Similarity {
    let rows = |row: usize| [0, 1, 2].map(|column| similarity.rotation[(row, column)]);
    ties::Similarity {
        scale: similarity.scale,
        rotation: [0, 1, 2].map(rows),
        translation: similarity.translation.into(),
    }
}

fn restored(stored: &ties::Similarity) -> Similarity {
    Similarity {
        scale: stored.scale,
        rotation: nalgebra::Matrix3::from_fn(|row, column| stored.rotation[row][column]),
        translation: stored.translation.into(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_scene::{Scene, SiteFrame};
    use nalgebra::{Matrix3, Vector3};

    fn world(name: &str, site: Option<i64>) -> World {
        World {
            name: name.to_owned(),
            scene: Scene {
                site: site.map(|site| SiteFrame {
                    site,
                    origin_m: [10.0, 0.0, 0.0],
                }),
                ..Scene::default()
            },
        }
    }

    fn moved(x: f64) -> Similarity {
        Similarity {
            scale: 2.0,
            rotation: Matrix3::identity(),
            translation: Vector3::new(x, 0.0, 0.0),
        }
    }

    #[test]
    fn ties_lead_to_sites_over_the_strongest_and_nothing_else_is_tied() {
        let worlds = [
            world("a", Some(3)),
            world("b", None),
            world("c", None),
            world("d", None),
            world("e", Some(4)),
        ];
        let links = [
            ([0, 1], moved(1.0), 50),
            ([0, 2], moved(9.0), 20),
            ([1, 2], moved(5.0), 30),
        ];
        let found = common_frames(&worlds, &links);
        let told: Vec<(&str, &str, By)> = found
            .iter()
            .map(|one| (one.name.as_str(), one.frame.as_str(), one.by))
            .collect();
        assert_eq!(
            told,
            [
                ("a", "site 3", By::Labels),
                ("b", "site 3", By::Overlap),
                ("c", "site 3", By::Overlap),
                ("d", "d", By::Itself),
                ("e", "site 4", By::Labels)
            ]
        );
        assert_eq!(found[2].through, ["a", "b"], "30 points of b, not 20 of a");
        // 2 (2 x + 5) + 1 + 10.
        let of_c = &found[2].frame_from_world;
        assert_eq!((of_c.scale, of_c.translation[0]), (4.0, 21.0));
    }

    #[test]
    fn without_a_site_ties_lead_to_the_world_of_the_first_of_equal_scenes() {
        let worlds = [world("a", None), world("b", None)];
        let found = common_frames(&worlds, &[([0, 1], moved(6.0), 30)]);
        assert_eq!((found[0].by, found[1].by), (By::Itself, By::Overlap));
        assert_eq!(found[1].frame, "a");
        // With a site on the other side the tie is walked back.
        let worlds = [world("a", None), world("b", Some(1))];
        let found = common_frames(&worlds, &[([0, 1], moved(6.0), 30)]);
        assert_eq!((found[0].frame.as_str(), found[0].by), ("site 1", By::Overlap));
        // (x - 6) / 2 + 10.
        let of_a = &found[0].frame_from_world;
        assert_eq!((of_a.scale, of_a.translation[0]), (0.5, 7.0));
    }
}
