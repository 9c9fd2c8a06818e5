//! The results of the nodes of a run in words.

use marf_engine::{NodeRun, NodeState};
use marf_progress::format::{count, node_counts};
use marf_schema::scenes::Scenes;
use marf_schema::scores::Scores;
use marf_schema::{bootstrap, evaluate, train};
use marf_stage::Document;

use crate::error::Error;
use crate::session::Session;

/// Returns the word for a state, as all verbs print it.
pub fn state_word(state: NodeState) -> &'static str {
    match state {
        NodeState::Reused => "reused",
        NodeState::Finished => "ran",
        NodeState::Failed => "failed",
        NodeState::Skipped => "skipped",
        NodeState::Cancelled => "stopped",
    }
}

/// Returns the result of a node in words: its photos, means of its metrics, or the message of a failure.
pub fn result(node: &NodeRun, session: &Session) -> String {
    if matches!(node.state, NodeState::Failed | NodeState::Skipped) {
        return node.reason.clone();
    }
    let mut parts = node_counts(&node.counts);
    parts.extend(figures(node, session).unwrap_or_else(|error| vec![error.message().to_owned()]));
    parts.join(", ")
}

/// Returns the means of a node's metrics, if it is of a stage that has some.
fn figures(node: &NodeRun, session: &Session) -> Result<Vec<String>, Error> {
    let of_scores = |scores: Scores| {
        let psnr = format!("held-out PSNR {:.3} dB", scores.psnr);
        let ssim = scores.ssim.map(|ssim| format!("SSIM {ssim:.3}"));
        [psnr].into_iter().chain(ssim).collect()
    };
    Ok(match node.stage.as_str() {
        train::Metrics::STAGE => of_scores(session.document::<train::Metrics>(node)?.scores),
        evaluate::Metrics::STAGE => of_scores(session.document::<evaluate::Metrics>(node)?.scores),
        Scenes::STAGE => {
            let scenes = session.document::<Scenes>(node)?;
            let photos: usize = scenes.scenes.iter().map(|scene| scene.photos.len()).sum();
            let left_out = (!scenes.skipped.is_empty())
                .then(|| format!("{} left out", count(scenes.skipped.len(), "group")));
            let found = [count(scenes.scenes.len(), "scene"), count(photos, "photo")];
            found.into_iter().chain(left_out).collect()
        }
        bootstrap::Metrics::STAGE => {
            let metrics = session.document::<bootstrap::Metrics>(node)?;
            vec![format!("mean std {:.3}", metrics.std)]
        }
        _ => Vec::new(),
    })
}
