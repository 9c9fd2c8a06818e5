//! The pipeline as a layered drawing: producers left, consumers right, in bands like lines of a text.

use std::collections::{BTreeMap, BTreeSet};

use marf_model::RunNode;
use maud::{Markup, html};

use super::format::{count, cut, duration, px};
use super::page::{Page, key};
use super::report::{FAILED, Report, SKIPPED, STATES, WAITING, state};

const BOX_WIDTH: f64 = 150.0;
const BOX_HEIGHT: f64 = 54.0;
const COLUMN: f64 = 190.0;
const ROW: f64 = 66.0;
/// Height of a line that only passes through a column.
const TRACK: f64 = 14.0;
const BAND_GAP: f64 = 36.0;
/// Lines that go on in another band keep this far apart, up to [`LANES`] of them.
const LANE: f64 = 5.0;
const LANES: usize = 5;
/// Space left and right of the boxes for lines that go on in another band.
const MARGIN: f64 = 36.0;
/// Most columns of a band: 6 x 190 px fit a page of 1400 px, and one of 1000 px a little smaller.
const MOST_COLUMNS: usize = 6;

/// Draws the nodes and what flows between them.
pub(super) fn body(page: &Page<'_>) -> Markup {
    let (report, nodes) = (page.report, &page.report.nodes);
    if nodes.is_empty() {
        return page.absent("a graph: it has no nodes");
    }
    let layout = Layout::new(report);
    html! {
        div.scroll {
            svg.graph viewBox={ "0 0 " (px(layout.width)) " " (px(layout.height)) }
                width=(px(layout.width)) height=(px(layout.height)) role="img" aria-labelledby="graph-title" {
                title id="graph-title" { "Graph of " (count(nodes.len(), "node")) ", inputs on the left" }
                @for path in layout.paths(report) { path.edge d=(path) {} }
                @for (node, place) in nodes.iter().zip(&layout.boxes) { (drawn(report, node, place)) }
            }
        }
        p.legend {
            @for word in STATES { (key(word, word)) }
        }
    }
}

fn drawn(report: &Report<'_>, node: &RunNode, place: &Place) -> Markup {
    let (x, y) = (place.x, place.y);
    html! {
        g.node.(state(node)) {
            title { (node.run.name) " (" (node.run.stage) "), " (state(node)) ": " (node.run.reason) }
            rect x=(px(x)) y=(px(y)) width=(px(BOX_WIDTH)) height=(px(BOX_HEIGHT)) rx="5" {}
            text.name x=(px(x + 10.0)) y=(px(y + 18.0)) { (cut(&node.run.name, 16)) }
            text x=(px(x + 10.0)) y=(px(y + 33.0)) { (state_line(node)) }
            text x=(px(x + 10.0)) y=(px(y + 47.0)) { (third_line(report, node)) }
        }
    }
}

fn state_line(node: &RunNode) -> String {
    match node.worked_s {
        Some(time) if ["ran", FAILED].contains(&state(node)) => {
            format!("{}, {}", state(node), duration(time))
        }
        _ => state(node).to_owned(),
    }
}

fn third_line(report: &Report<'_>, node: &RunNode) -> String {
    let children: Vec<&RunNode> = report.run.children(&node.run.name).collect();
    if children.is_empty() {
        return if node.run.stage == node.run.name {
            String::new()
        } else {
            cut(&node.run.stage, 22)
        };
    }
    let all = count(children.len(), "sub-node");
    // Those of a node without a result in this run may have run in the one whose outputs are shown.
    if [SKIPPED, WAITING].contains(&state(node)) {
        return all;
    }
    let ran = children.iter().filter(|child| state(child) == "ran").count();
    cut(&format!("{all}, {ran} ran"), 24)
}

/// Top-left corner of a box.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
struct Place {
    x: f64,
    y: f64,
}

/// Where everything is.
#[derive(Debug)]
struct Layout {
    boxes: Vec<Place>,
    layers: Vec<usize>,
    /// (source, layer) to the height at which its line passes that layer.
    tracks: BTreeMap<(usize, usize), f64>,
    /// Layer to the sources of all lines that enter it.
    crossing: BTreeMap<usize, BTreeSet<usize>>,
    columns: usize,
    bands: Vec<f64>,
    width: f64,
    height: f64,
}

impl Layout {
    fn new(report: &Report<'_>) -> Self {
        let (edges, nodes) = (edges(report), &report.nodes);
        let layers = layers(nodes.len(), &edges);
        let depth = layers.iter().max().map_or(0, |last| last + 1);
        let bands = depth.div_ceil(MOST_COLUMNS).max(1);
        let columns = depth.div_ceil(bands).max(1);
        let mut layout = Self {
            boxes: vec![Place::default(); nodes.len()],
            tracks: BTreeMap::new(),
            crossing: crossing(&layers, &edges),
            columns,
            bands: Vec::new(),
            width: 2.0 * MARGIN + columns as f64 * COLUMN - (COLUMN - BOX_WIDTH),
            height: 0.0,
            layers,
        };
        layout.stack(depth, &passing(&layout.layers, &edges));
        layout
    }

    /// Stacks each layer: boxes first, in the order of the input, then the lines that pass by.
    fn stack(&mut self, depth: usize, passing: &BTreeMap<usize, BTreeSet<usize>>) {
        let mut top = 4.0;
        for band in 0..depth.div_ceil(self.columns) {
            self.bands.push(top);
            let mut bottom = top;
            for layer in band * self.columns..((band + 1) * self.columns).min(depth) {
                bottom = f64::max(bottom, self.stack_layer(layer, top, passing.get(&layer)));
            }
            top = bottom + BAND_GAP;
        }
        self.height = top - BAND_GAP + 6.0;
    }

    fn stack_layer(&mut self, layer: usize, top: f64, passing: Option<&BTreeSet<usize>>) -> f64 {
        let x = MARGIN + (layer % self.columns) as f64 * COLUMN;
        let mut y = top;
        for index in 0..self.boxes.len() {
            if self.layers[index] == layer {
                self.boxes[index] = Place { x, y };
                y += ROW;
            }
        }
        for source in passing.into_iter().flatten() {
            self.tracks.insert((*source, layer), y);
            y += TRACK;
        }
        y
    }

    /// One path for each edge. A line that leaves a band continues at the left of the next.
    fn paths(&self, report: &Report<'_>) -> BTreeSet<String> {
        let edges = edges(report);
        edges
            .iter()
            .flat_map(|(from, to)| self.path(*from, *to))
            .collect()
    }

    fn path(&self, from: usize, to: usize) -> Vec<String> {
        let mut pieces = Vec::new();
        let middle = |place: Place| place.y + BOX_HEIGHT / 2.0;
        let mut at = (self.boxes[from].x + BOX_WIDTH, middle(self.boxes[from]));
        for layer in self.layers[from] + 1..=self.layers[to] {
            let last = layer == self.layers[to];
            let x = MARGIN + (layer % self.columns) as f64 * COLUMN;
            let track = self.tracks.get(&(from, layer)).copied().unwrap_or(at.1);
            let y = if last { middle(self.boxes[to]) } else { track };
            if layer % self.columns == 0 {
                at = self.wrap(at, y, self.lane(from, layer), &mut pieces);
            }
            pieces.push(curve(at, (x, y)));
            at = (x, y);
            if !last {
                pieces.push(curve(at, (x + BOX_WIDTH, y)));
                at.0 = x + BOX_WIDTH;
            }
        }
        pieces.push(arrow(at));
        pieces
    }

    /// The place of a source among those whose lines enter a band, from the top.
    fn lane(&self, from: usize, layer: usize) -> f64 {
        let entering = self.crossing.get(&layer).into_iter().flatten();
        (entering.filter(|source| **source < from).count() % LANES) as f64 * LANE
    }

    /// Runs to the right edge, along the gap between the bands and back in from the left.
    fn wrap(&self, at: (f64, f64), y: f64, lane: f64, pieces: &mut Vec<String>) -> (f64, f64) {
        let band = self.bands.iter().rposition(|top| *top <= y).unwrap_or(0);
        let gap = self.bands.get(band).copied().unwrap_or(0.0) - BAND_GAP / 2.0 - lane + 8.0;
        let (right, left) = (self.width - 28.0 + lane, 28.0 - lane);
        pieces.push(format!(
            "M{} {}H{}V{}H{}V{}H{}",
            px(at.0),
            px(at.1),
            px(right),
            px(gap),
            px(left),
            px(y),
            px(left + 4.0)
        ));
        (left + 4.0, y)
    }
}

fn curve(from: (f64, f64), to: (f64, f64)) -> String {
    let bend = (to.0 - from.0) / 2.0;
    format!(
        "M{} {}C{} {} {} {} {} {}",
        px(from.0),
        px(from.1),
        px(from.0 + bend),
        px(from.1),
        px(to.0 - bend),
        px(to.1),
        px(to.0),
        px(to.1)
    )
}

/// The head of an arrow that points right.
fn arrow(at: (f64, f64)) -> String {
    let (back, up, down) = (px(at.0 - 6.0), px(at.1 - 3.5), px(at.1 + 3.5));
    format!("M{back} {up}L{} {}L{back} {down}", px(at.0), px(at.1))
}

/// (Producer, consumer) as places in the list. Names outside of it are left out.
fn edges(report: &Report<'_>) -> BTreeSet<(usize, usize)> {
    let nodes = || report.nodes.iter().enumerate();
    let places: BTreeMap<&str, usize> = nodes()
        .map(|(place, node)| (node.run.name.as_str(), place))
        .collect();
    nodes()
        .flat_map(|(to, node)| report.upstream(node).into_iter().map(move |from| (from, to)))
        .filter_map(|(from, to)| Some((*places.get(from)?, to)))
        .filter(|(from, to)| from != to)
        .collect()
}

/// Longest way from an input, in steps. A cycle, which no pipeline has, ends after as many rounds as nodes.
fn layers(count: usize, edges: &BTreeSet<(usize, usize)>) -> Vec<usize> {
    let mut layers = vec![0; count];
    for _ in 0..count {
        let mut moved = false;
        for (from, to) in edges {
            let behind = (layers[*from] + 1).min(count.saturating_sub(1));
            moved |= layers[*to] < behind;
            layers[*to] = layers[*to].max(behind);
        }
        if !moved {
            break;
        }
    }
    layers
}

/// For each layer the sources whose lines pass it on their way to a later one.
fn passing(layers: &[usize], edges: &BTreeSet<(usize, usize)>) -> BTreeMap<usize, BTreeSet<usize>> {
    let mut passing: BTreeMap<usize, BTreeSet<usize>> = BTreeMap::new();
    for (from, to) in edges {
        for layer in layers[*from] + 1..layers[*to] {
            passing.entry(layer).or_default().insert(*from);
        }
    }
    passing
}

/// For each layer the sources of the lines that enter or pass it.
fn crossing(layers: &[usize], edges: &BTreeSet<(usize, usize)>) -> BTreeMap<usize, BTreeSet<usize>> {
    let mut crossing = passing(layers, edges);
    for (from, to) in edges {
        crossing.entry(layers[*to]).or_default().insert(*from);
    }
    crossing
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixture::{Store, child, node};
    use marf_engine::NodeState;

    fn diamond() -> Vec<RunNode> {
        vec![
            node("a", &[]),
            node("b", &["a"]),
            node("c", &["b", "a"]),
            node("d", &["a", "nowhere"]),
        ]
    }

    #[test]
    fn a_layer_is_the_longest_way_from_an_input() {
        let found = Store::default().with_report(&diamond(), |report| layers(4, &edges(report)));
        assert_eq!(found, [0, 1, 2, 1]);
    }

    #[test]
    fn sub_nodes_of_a_skipped_node_are_not_said_to_have_run() {
        let state_is = |state| {
            let mut parent = node("b", &[]);
            parent.run.state = state;
            let children =
                [NodeState::Finished, NodeState::Reused].map(|state| child(&parent, "0", state, None));
            let nodes = [vec![parent], children.to_vec()].concat();
            Store::default().with_report(&nodes, |report| third_line(report, report.nodes[0]))
        };
        assert_eq!(state_is(NodeState::Finished), "2 sub-nodes, 1 ran");
        assert_eq!(state_is(NodeState::Skipped), "2 sub-nodes");
    }

    #[test]
    fn boxes_never_overlap_and_lie_inside_the_drawing() {
        let chain: Vec<RunNode> = (0..40)
            .map(|index: usize| {
                let before = format!("n{}", index.saturating_sub(1 + index % 3));
                node(&format!("n{index}"), &[&before])
            })
            .collect();
        let layout = Store::default().with_report(&chain, Layout::new);
        for (index, one) in layout.boxes.iter().enumerate() {
            assert!(one.x + BOX_WIDTH <= layout.width, "{index}: {one:?}");
            assert!(one.y + BOX_HEIGHT <= layout.height, "{index}: {one:?}");
            for other in &layout.boxes[..index] {
                let apart = (one.x - other.x).abs() >= BOX_WIDTH || (one.y - other.y).abs() >= BOX_HEIGHT;
                assert!(apart, "{index}: {one:?} on {other:?}");
            }
        }
    }

    #[test]
    fn a_cycle_ends_in_a_drawing() {
        let nodes = [node("a", &["b"]), node("b", &["a"]), node("c", &["c"])];
        let layout = Store::default().with_report(&nodes, Layout::new);
        assert_eq!(layout.boxes.len(), 3);
    }
}
