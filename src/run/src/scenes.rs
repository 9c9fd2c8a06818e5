//! Pipelines whose photos are split by place: their scenes, and requests for one of them.

use std::path::Path;

use marf_engine::{Options, Purpose};
use marf_schema::scenes::{PhotoGroup, Scenes};

use marf_config::scenes::scene_of;

use crate::error::{Diagnostic, Error};
use crate::execute::{execute, options};
use crate::session::{Session, node_named};

/// Which nodes a request is about.
#[derive(Debug, Clone, Default)]
pub struct Selection {
    /// Only what leads to this node.
    pub to: Option<String>,
    /// Only this node and what follows from it.
    pub from: Option<String>,
    /// Only this scene, where the photos are split by place.
    pub scene: Option<String>,
}

/// Nodes that a selection names.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct SelectedNodes {
    /// The nodes to run to.
    pub to: Vec<String>,
    /// The nodes to run from.
    pub from: Vec<String>,
}

/// Most groups that are not scenes to print during a run. The report lists all.
const MOST_NAMED: usize = 5;

/// Returns the session with its nodes for each scene. The node that splits the photos runs first, unless only nodes before it are selected.
///
/// # Errors
/// An error that keeps the photos from being split, or a scene of a pipeline without scenes.
pub fn found(mut session: Session, selection: &Selection) -> Result<Session, Error> {
    let Some(by_scene) = &session.by_scene else {
        return match &selection.scene {
            None => Ok(session),
            Some(scene) => Err(Error::Usage(
                Diagnostic::new(format!(
                    "--scene {scene}: this pipeline does not split its photos by place"
                ))
                .hint("put a node `scenes` between the filters and `calibrate`"),
            )),
        };
    };
    let is_after = |node: &String| by_scene.nodes.contains(node) || by_scene.after.contains(node);
    let is_before = |node: &String| !is_after(node) && scene_of(node).is_none();
    if selection.scene.is_none() && selection.to.as_ref().is_some_and(is_before) {
        return Ok(session);
    }
    let split = by_scene.split.clone();
    let derived = session.derived_source(Purpose::Scenes)?;
    let source = std::mem::replace(&mut session.source, derived);
    let options = Options {
        to: vec![split.clone()],
        ..options(&session)
    };
    let record = execute(&session, &options)?.done()?;
    session.source = source;
    let scenes: Scenes = session.document(node_named(&record, &split)?)?;
    left_out(&scenes.skipped)
        .iter()
        .for_each(|line| session.context.feedback.note(line));
    session.for_scenes(&scenes)
}

/// Refuses a pipeline of many scenes where one is measured.
///
/// # Errors
/// A pipeline whose photos are split by place, with what takes one of its scenes.
pub fn one(session: &Session) -> Result<(), Error> {
    let Some(by_scene) = &session.by_scene else {
        return Ok(());
    };
    let split = &by_scene.split;
    let diagnostic = Diagnostic::new(format!(
        "`{split}` splits the photos by place, and one scene is measured at a time"
    ));
    let hint =
        format!("take one: `--set calibrate.input={split}/NAME`. `marf run --to {split}` prints their names");
    Err(Error::Usage(diagnostic.hint(hint)))
}

/// Returns a line for each group that is not a scene, or the number of further groups.
fn left_out(skipped: &[PhotoGroup]) -> Vec<String> {
    let line = |group: &PhotoGroup| format!("no scene  {}: {}", group.name, group.reason);
    let more = skipped.len().saturating_sub(MOST_NAMED);
    let rest = (more > 0).then(|| format!("no scene  {more} other groups, which the report names"));
    skipped.iter().take(MOST_NAMED).map(line).chain(rest).collect()
}

/// Returns the nodes that a selection names. A node that runs for each scene is selected in all scenes, or in the selected one.
///
/// # Errors
/// A scene that is not there.
pub fn selected(session: &Session, selection: &Selection) -> Result<SelectedNodes, Error> {
    let given = |name: &Option<String>| name.iter().cloned().collect::<Vec<String>>();
    let Some(by_scene) = &session.by_scene else {
        return Ok(SelectedNodes {
            to: given(&selection.to),
            from: given(&selection.from),
        });
    };
    let scenes = match &selection.scene {
        None => session.scenes.clone(),
        Some(scene) if session.scenes.contains(scene) => vec![scene.clone()],
        Some(scene) => {
            let diagnostic = Diagnostic::new(format!("--scene {scene}: unknown scene"));
            let known = format!("the scenes are {}", session.scenes.join(", "));
            return Err(Error::Usage(diagnostic.hint(known)));
        }
    };
    let named = |names: Vec<String>| -> Vec<String> {
        let each = names.iter().map(|name| by_scene.named(name, &scenes));
        each.collect::<Vec<_>>().concat()
    };
    let to = match (&selection.to, &selection.scene) {
        (None, Some(_)) => named(by_scene.nodes.iter().cloned().collect()),
        (to, _) => named(given(to)),
    };
    Ok(SelectedNodes {
        to,
        from: named(given(&selection.from)),
    })
}

/// Folder of the pages of scenes, next to the report.
pub const SCENE_PAGES: &str = "pages";

/// Returns the name of the page of a scene, from where the report is.
pub fn page_name(scene: &str) -> String {
    format!("{SCENE_PAGES}/{scene}.html")
}

/// Returns whether a document of a run is the page of a scene.
pub fn is_page(document: &str) -> bool {
    Path::new(document).parent() == Some(Path::new(SCENE_PAGES))
}

/// Returns the node that a name in a run is of: children are `parent/child`.
pub fn parent_of(node: &str) -> &str {
    node.split('/').next().unwrap_or(node)
}

/// Returns whether a name in a run is that of a node of a scene, or for none of one that all scenes share.
pub fn is_of(node: &str, scene: Option<&str>) -> bool {
    scene_of(parent_of(node)) == scene
}

#[cfg(test)]
mod tests {
    use super::*;
    use marf_config::scenes::node_of;

    #[test]
    fn groups_that_are_no_scene_are_named_up_to_five() {
        let group = |index: usize| PhotoGroup {
            name: format!("g{index}"),
            reason: "1 photo".to_owned(),
            ..PhotoGroup::default()
        };
        let groups: Vec<PhotoGroup> = (0..8).map(group).collect();
        let lines = left_out(&groups);
        assert_eq!(lines.len(), 6);
        assert_eq!(lines[0], "no scene  g0: 1 photo");
        assert_eq!(lines[5], "no scene  3 other groups, which the report names");
        assert_eq!(left_out(&groups[..5]).len(), 5);
    }

    #[test]
    fn children_are_of_the_scene_of_their_parent() {
        assert!(is_of(&node_of("tune", "a"), Some("a")));
        assert!(is_of("tune@a/trial-03", Some("a")));
        assert!(is_of("extract", None) && is_of("tune/trial@03", None));
        assert!(!is_of("tune@a", None) && !is_of("tune@a", Some("b")));
    }
}
