//! Positions and directions of the cameras, from above and from the side.

use std::collections::BTreeMap;

use marf_cache::Digest;
use marf_model::RunNode;
use marf_scene::{Frame, Point, Scene};
use marf_schema::{calibrate, output};
use maud::{Markup, html};

use super::axis::round_step;
use super::camera_view::{Axes, Fit, View, WIDTH, centre, fitted};
use super::format::{count, number, px};
use super::json;
use super::page::{Page, has_document, key};
use super::quality::{figures, of_calibration};
use super::read::{Missing, unreadable};
use super::unplaced;
use super::vector::{Vec3, add, scaled, unit};

/// Most sparse points that are drawn, evenly from all.
const MOST_POINTS: usize = 3_000;
const FEW_POINTS: usize = 600;
/// Length of a drawn view, as a share of the longer side of the drawing, and that of the one camera of a
/// plan.
const VIEW_SHARE: f64 = 0.06;
const PLAN_SHARE: f64 = 0.16;
/// Width of a plan next to pictures, pixels, and most cameras that it shows, evenly from all.
const PLAN_WIDTH: f64 = 220.0;
const MOST_CAMERAS: usize = 500;
/// With more cameras than this they have no names in the drawings, and most that are drawn then.
const MOST_NAMED: usize = 500;
const MOST_DRAWN: usize = 2_000;
/// Reprojection errors up to which a camera has the first colours, pixels. The last colour is for all above.
const ERRORS_PX: [f64; 3] = [0.5, 1.0, 2.0];

/// Every scene of the run once, with the nodes that hold it.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let mut holders: BTreeMap<Digest, Vec<&RunNode>> = BTreeMap::new();
    let mut order = Vec::new();
    for node in page.with_output(output::SCENE) {
        if let Some(digest) = node.digest(output::SCENE) {
            if !holders.contains_key(digest) {
                order.push(*digest);
            }
            holders.entry(*digest).or_default().push(node);
        }
    }
    if order.is_empty() {
        return page.absent("a scene with cameras");
    }
    html! { @for nodes in order.iter().filter_map(|digest| holders.get(digest)) { (of_nodes(page, nodes)) } }
}

fn of_nodes(page: &Page<'_>, nodes: &[&RunNode]) -> Markup {
    let names: Vec<&str> = nodes.iter().map(|node| node.run.name.as_str()).collect();
    let Some(first) = nodes.first() else {
        return html! {};
    };
    html! {
        h3 { (names.join(", ")) }
        @match scene(page, first) {
            Ok(scene) => (of_scene(&scene)),
            Err(missing) => (missing),
        }
        @if has_document::<calibrate::Metrics>(first) { (metrics(page, first)) }
    }
}

/// Reads the scene of a node.
pub(super) fn scene(page: &Page<'_>, node: &RunNode) -> Result<Scene, Missing> {
    let bytes = page.bytes(node, output::SCENE)?;
    Scene::decode(&bytes).map_err(|error| unreadable(node, output::SCENE, &error))
}

/// Figures of the calibration itself.
fn metrics(page: &Page<'_>, node: &RunNode) -> Markup {
    match page.document::<calibrate::Metrics>(node) {
        Ok(metrics) => html! {
            (figures(&of_calibration(&metrics)))
            (json::folded("all metrics of the calibration", &without_photos(metrics)))
        },
        Err(missing) => html! { (missing) },
    }
}

/// The sums alone: the lists have an entry for each photo, megabytes of a large run.
fn without_photos(metrics: calibrate::Metrics) -> calibrate::Metrics {
    calibrate::Metrics {
        photos: Vec::new(),
        missing: Vec::new(),
        stereo_pairs: Vec::new(),
        ..metrics
    }
}

fn of_scene(scene: &Scene) -> Markup {
    let held_out = scene.frames.iter().filter(|frame| frame.held_out).count();
    let axes = Axes::new(scene);
    html! {
        p {
            (count(scene.frames.len(), "camera")) ", " (held_out) " held out; "
            (count(scene.points.len(), "sparse point")) "; " (scale_words(scene)) "; " (axes.words) "."
            @if !scene.method.is_empty() { " Method: " (scene.method) "." }
            @if scene.frames.len() > MOST_DRAWN {
                " Drawn are " (evenly(&scene.frames, MOST_DRAWN).count()) " of them, evenly from all."
            }
        }
        @if !scene.frames.is_empty() {
            div.charts {
                figure { (drawing(scene, &axes.above(), "Cameras from above", MOST_POINTS)) figcaption { "from above" } }
                figure { (drawing(scene, &axes.aside(), "Cameras from the side", MOST_POINTS)) figcaption { "from the side" } }
            }
            p { (legend(scene)) }
        }
        (unplaced::table(&scene.unplaced))
    }
}

/// What the colours of cameras and points mean.
pub(super) fn legend(scene: &Scene) -> Markup {
    html! {
        span.legend {
            (key("train", "trained on")) (key("held-out", "held out")) (key("point", "sparse point"))
            @if scene.frames.iter().any(|frame| frame.error_px.is_some()) { (error_legend()) }
        }
    }
}

fn error_legend() -> Markup {
    html! {
        span { "filled by mean reprojection error:" }
        @for (rank, error_px) in ERRORS_PX.iter().enumerate() {
            (key(&error_class(rank), &format!("up to {} px", number(*error_px))))
        }
        (key(&error_class(ERRORS_PX.len()), "more"))
    }
}

fn error_class(rank: usize) -> String {
    format!("error{rank}")
}

/// Plan of single cameras of a scene, seen from above.
pub(super) struct Plan {
    scene: Scene,
}

impl Plan {
    /// Reads the scene of a node, or of one that it reads. `None` without a readable scene: the section on
    /// cameras says why.
    pub(super) fn new(page: &Page<'_>, node: &RunNode) -> Option<Self> {
        let upstream = page.report.upstream(node).into_iter();
        let read = upstream.filter_map(|name| page.report.node(name));
        let mut holders = [node].into_iter().chain(read);
        let holder = holders.find(|node| node.digest(output::SCENE).is_some())?;
        let scene = scene(page, holder).ok()?;
        Some(Self { scene })
    }

    /// Draws the position of a photo, and of the nearest photo trained on, among all. `None` without a camera
    /// of this id.
    pub(super) fn whereabouts(&self, id: &str, nearest: Option<&str>) -> Option<Markup> {
        let find = |id: &str| self.scene.frames.iter().find(|frame| frame.id == id);
        let (own, nearest) = (find(id)?, nearest.and_then(find));
        let axes = Axes::new(&self.scene);
        let view = axes.above();
        let fit = fitted(&self.scene, &view);
        let frames = &self.scene.frames;
        let dots: String = evenly(frames, MOST_CAMERAS)
            .map(|frame| {
                let (x, y) = fit.place(centre(frame));
                format!("M{} {}h0", px(x), px(y))
            })
            .collect();
        Some(html! {
            svg.cameras.plan viewBox={ "0 0 " (px(WIDTH)) " " (px(fit.height)) } width=(px(PLAN_WIDTH))
                height=(px(PLAN_WIDTH * fit.height / WIDTH)) role="img" aria-label={ "where " (own.file) " was taken" } {
                path.others d=(dots) {}
                @if let Some(nearest) = nearest {
                    @let (x, y) = fit.place(centre(nearest));
                    circle.nearest cx=(px(x)) cy=(px(y)) r="13" { title { "nearest photo trained on: " (nearest.file) } }
                }
                (frustum(own, &fit, PLAN_SHARE))
            }
        })
    }
}

fn scale_words(scene: &Scene) -> String {
    match scene.metres_per_unit {
        Some(metres) => format!("1 unit is {} m", number(metres)),
        None => "no scale: lengths are in units of the scene".to_owned(),
    }
}

/// Draws the cameras from above with few points.
pub(super) fn overview(scene: &Scene) -> Markup {
    drawing(
        scene,
        &Axes::new(scene).above(),
        "Cameras of the scene from above",
        FEW_POINTS,
    )
}

fn drawing(scene: &Scene, view: &View, title: &str, most_points: usize) -> Markup {
    let fit = fitted(scene, view);
    // Held-out cameras last, so that they lie on top.
    let (held_out, train): (Vec<&Frame>, Vec<&Frame>) = scene.frames.iter().partition(|frame| frame.held_out);
    html! {
        svg.cameras viewBox={ "0 0 " (px(WIDTH)) " " (px(fit.height)) } width=(px(WIDTH)) height=(px(fit.height))
            role="img" aria-label={ (title) ": " (count(scene.frames.len(), "camera")) } {
            g.points { @for point in evenly(&scene.points, most_points) { (dot_of(point, &fit)) } }
            @if scene.frames.len() <= MOST_NAMED {
                @for frame in train.into_iter().chain(held_out) { (frustum(frame, &fit, VIEW_SHARE)) }
            } @else {
                @for ((_, class), path) in many(scene, &fit) { path.view.(class) d=(path) {} }
            }
            (scale_bar(scene, &fit))
            (compass(view, &fit))
        }
    }
}

fn dot_of(point: &Point, fit: &Fit<'_>) -> Markup {
    let (x, y) = fit.place(point.position);
    let inside = (0.0..WIDTH).contains(&x) && (0.0..fit.height).contains(&y);
    html! { @if inside { circle cx=(px(x)) cy=(px(y)) r="1" {} } }
}

/// Returns the centre of a camera and the two edges of its view, each as long as a share of the drawing in space, pixels.
fn corners(frame: &Frame, fit: &Fit<'_>, share: f64) -> [(f64, f64); 3] {
    let length = share * WIDTH / fit.px_each;
    let eye = centre(frame);
    let camera = &frame.camera;
    let edge = |column_px: f64| {
        let row = (f64::from(camera.height) / 2.0 - camera.cy_px) / camera.fy_px;
        let in_cam = [(column_px - camera.cx_px) / camera.fx_px, row, 1.0];
        let direction = unit(world_direction(frame, in_cam)).unwrap_or_default();
        fit.place(add(eye, scaled(direction, length)))
    };
    [fit.place(eye), edge(0.0), edge(f64::from(camera.width))]
}

/// Returns the classes of a camera: what it is for, and how far its points are from where the photo shows them.
fn class(frame: &Frame) -> String {
    let rank = |error_px: f64| ERRORS_PX.iter().filter(|most| error_px > **most).count();
    let error = frame
        .error_px
        .map_or_else(String::new, |error_px| error_class(rank(error_px)));
    format!("{} {error}", if frame.held_out { "held-out" } else { "train" })
}

/// Returns some of very many cameras, evenly from all, as one path for each class, in whole pixels: those held out last, on top.
fn many(scene: &Scene, fit: &Fit<'_>) -> BTreeMap<(bool, String), String> {
    let mut paths: BTreeMap<(bool, String), String> = BTreeMap::new();
    for frame in evenly(&scene.frames, MOST_DRAWN) {
        let [eye, left, right] =
            corners(frame, fit, VIEW_SHARE).map(|(x, y)| (x.round() as i64, y.round() as i64));
        let path = paths.entry((frame.held_out, class(frame))).or_default();
        let (ax, ay, bx, by) = (left.0 - eye.0, left.1 - eye.1, right.0 - left.0, right.1 - left.1);
        path.push_str(&format!("M{} {}l{ax} {ay} {bx} {by}z", eye.0, eye.1));
    }
    paths
}

/// Returns at most `most` of all, evenly.
fn evenly<T>(all: &[T], most: usize) -> impl Iterator<Item = &T> {
    all.iter().step_by(all.len().div_ceil(most).max(1))
}

/// The centre and the two edges of the view, with the camera's name.
fn frustum(frame: &Frame, fit: &Fit<'_>, share: f64) -> Markup {
    let corners = corners(frame, fit, share);
    let points: Vec<String> = corners
        .iter()
        .map(|(x, y)| format!("{},{}", px(*x), px(*y)))
        .collect();
    html! {
        g.(class(frame)) {
            title {
                (frame.file) @if frame.held_out { ", held out" }
                @if let Some(error) = frame.error_px { ", reprojection error " (number(error)) " px" }
            }
            polygon points=(points.join(" ")) {}
            circle cx=(px(corners[0].0)) cy=(px(corners[0].1)) r="2.5" {}
        }
    }
}

/// A bar of a round length, about a fifth of the drawing wide.
fn scale_bar(scene: &Scene, fit: &Fit<'_>) -> Markup {
    let metres = scene
        .metres_per_unit
        .filter(|metres| metres.is_finite() && *metres > 0.0);
    let px_each = fit.px_each / metres.unwrap_or(1.0);
    let length = round_step(WIDTH / 8.0 / px_each);
    let (left, base) = (16.0, fit.height - 16.0);
    let right = left + length * px_each;
    let text = match metres {
        Some(_) => format!("{} m", number(length)),
        None => format!("{} units, no scale", number(length)),
    };
    html! {
        path.bar d={ "M" (px(left)) " " (px(base - 5.0)) "V" (px(base)) "H" (px(right)) "V" (px(base - 5.0)) } {}
        text x=(px(left)) y=(px(base - 10.0)) { (text) }
    }
}

/// Names of the directions, in the corner. Empty if they have no name.
fn compass(view: &View, fit: &Fit<'_>) -> Markup {
    let (x, y) = (WIDTH - 60.0, fit.height - 22.0);
    html! {
        @if !view.top_name.is_empty() {
            path.bar d={ "M" (px(x)) " " (px(y)) "v-26m-4 6l4 -6l4 6" } {}
            text x=(px(x)) y=(px(y - 32.0)) text-anchor="middle" { (view.top_name) }
        }
        @if !view.right_name.is_empty() {
            path.bar d={ "M" (px(x)) " " (px(y)) "h26m-6 -4l6 4l-6 4" } {}
            text x=(px(x + 30.0)) y=(px(y + 4.0)) { (view.right_name) }
        }
    }
}

/// Rᵀ d: a direction of the camera in the world.
fn world_direction(frame: &Frame, direction: Vec3) -> Vec3 {
    let rotation = &frame.cam_from_world.rotation;
    [0, 1, 2].map(|column| (0..3).map(|row| rotation[(row, column)] * direction[row]).sum())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The camera at (0, -2) looks north: its two edges are higher on the page than its centre.
    #[test]
    fn a_plan_shows_one_camera_among_the_others_and_the_nearest() {
        let plan = Plan {
            scene: crate::fixture::scene(),
        };
        let drawn = plan.whereabouts("d.jpg", Some("a.jpg")).unwrap().into_string();
        assert!(drawn.contains("class=\"held-out error0\"") && drawn.contains("class=\"nearest\""));
        let dots = drawn.matches("h0").count();
        assert_eq!(dots, 4);
        let corners = drawn
            .split("points=\"")
            .nth(1)
            .unwrap()
            .split('"')
            .next()
            .unwrap();
        let rows: Vec<f64> = corners
            .split(' ')
            .map(|corner| corner.split_once(',').unwrap().1.parse().unwrap())
            .collect();
        assert!(rows[1] < rows[0] && rows[2] < rows[0], "{corners}");
        let alone = plan.whereabouts("d.jpg", Some("gone")).unwrap().into_string();
        assert!(!alone.contains("nearest\""));
        assert!(plan.whereabouts("gone", None).is_none());
    }

    /// A traverse of 10,000 photos: the drawings stay small, and those held out lie on top.
    #[test]
    fn very_many_cameras_are_drawn_in_a_few_paths() {
        let mut scene = crate::fixture::scene();
        let some = scene.frames.clone();
        scene.frames = (0..10_000)
            .map(|index| some[index % some.len()].clone())
            .collect();
        let page = of_scene(&scene).into_string();
        assert!(page.len() < 250_000, "{} bytes", page.len());
        assert!(page.contains("Drawn are 2000 of them"), "{page}");
        let above = page.split("</svg>").next().unwrap();
        let paths = above.split("<path class=\"view ").skip(1);
        let held_out: Vec<bool> = paths.map(|path| path.starts_with("held-out")).collect();
        assert!(
            held_out.len() > 1 && held_out.is_sorted() && held_out.contains(&true),
            "{held_out:?}"
        );
        assert_eq!(page.matches("<title>").count(), 0);
    }
}
