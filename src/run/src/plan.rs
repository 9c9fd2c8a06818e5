//! The actions of a run, planned without running it, and their reasons.

use marf_engine::{PlanOptions, PlannedNode};
use marf_schema::scenes::Scenes;
use marf_stage::Document;

use crate::context::Context;
use crate::error::Error;
use crate::scenes::{self, Selection};
use crate::session::Session;
use crate::shared::Shared;

/// Returns the state of every selected node and the first thing that changed.
///
/// # Errors
/// A pipeline or a selection that is wrong, a store that cannot be read, the wish to stop.
pub fn plan(context: &Context, selection: &Selection) -> Result<Vec<PlannedNode>, Error> {
    let session = known(Session::open(context)?)?;
    let last = session.last()?;
    let shared = Shared::open(&session)?;
    let options = PlanOptions {
        shared: shared.as_deref().map(|shared| shared as _),
        ..options(context)
    };
    let mut nodes = marf_engine::plan(&session.graph, &session.store, last.as_ref(), &options)?;
    let selected = scenes::selected(&session, selection)?;
    let chosen = session.graph.select(&selected.to, &selected.from)?;
    nodes.retain(|node| chosen.contains(&node.node));
    Ok(nodes)
}

fn options(context: &Context) -> PlanOptions<'_> {
    PlanOptions {
        threads: context.threads,
        cancel: context.cancel.clone(),
        shared: None,
    }
}

/// A question why a node would run.
#[derive(Debug, Clone)]
pub struct WhyRequest {
    /// The node.
    pub node: String,
    /// Whether every photo that was added, edited or removed is named.
    pub with_photos: bool,
}

/// Returns every difference between a node and the action of its last result.
///
/// # Errors
/// As [`plan`]. Also an unknown node.
pub fn why(context: &Context, request: &WhyRequest) -> Result<PlannedNode, Error> {
    let session = known(Session::open(context)?)?;
    let last = session.last()?;
    let (graph, store, node) = (&session.graph, &session.store, &request.node);
    let mut planned = marf_engine::why(graph, store, last.as_ref(), &options(context), node)?;
    if request.with_photos {
        let photos = marf_engine::photo_changes(graph, store, last.as_ref(), &options(context), node)?;
        planned.changes.extend(photos);
    }
    Ok(planned)
}

/// Returns the session with its nodes for each scene, as far as the scenes are known without running anything. They are the present scenes,
/// or those of the last run if the split is to run again.
fn known(session: Session) -> Result<Session, Error> {
    let Some(by_scene) = &session.by_scene else {
        return Ok(session);
    };
    let last = session.last()?;
    let (graph, store) = (&session.graph, &session.store);
    let nodes = marf_engine::plan(graph, store, last.as_ref(), &options(&session.context))?;
    let split = nodes.iter().find(|node| node.node == by_scene.split);
    let key = split
        .filter(|node| !node.state.is_open())
        .and_then(|node| node.key);
    let record = key.map(|key| session.store.record(&key)).transpose()?.flatten();
    let digest = record.and_then(|record| record.outputs.get(Scenes::OUTPUT).map(|output| output.digest));
    let Some(digest) = digest else {
        return session.for_scenes_of(last.as_ref());
    };
    let scenes = Scenes::decode(&session.store.get(&digest)?)
        .map_err(|error| Error::failed(format!("{}: {error}", Scenes::OUTPUT)))?;
    session.for_scenes(&scenes)
}
