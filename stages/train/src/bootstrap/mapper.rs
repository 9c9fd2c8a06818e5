//! Maps of every viewpoint, from the renders of all members.
//!
//! Viewpoints are visited twice, since scales and intervals follow from all of them. The maps of one viewpoint at a time are in memory.
//! Those of the first pass are kept among the checkpoints for the second.

use marf_cache::Digest;
use marf_field::{Field, Render};
use marf_scene::{Scene, path::Viewpoint};
use marf_schema::output::MAPS;
use marf_stage::{Ctx, Outputs, StageError};

use super::{
    drawing::Scales,
    maps::{Maps, maps},
    study::{ViewStudy, study},
    viewpoints::MapView,
    visibility::Witnesses,
};
use crate::{checkpoint::Journal, view::render_view};

/// Renders the fields of all members and maps where they disagree.
pub(super) struct Mapper<'a> {
    ctx: &'a Ctx<'a>,
    /// Identity of the node and its fields.
    identity: Digest,
    pub fields: Vec<Field>,
    /// What photos saw, by the member with the lowest seed: the delivered field, where it is a member.
    witnesses: Witnesses,
    /// Viewpoints that are done.
    done: u64,
    total: u64,
}

impl<'a> Mapper<'a> {
    /// Returns the mapper of `count` viewpoints. `identity` identifies the node and its fields.
    pub fn new(
        ctx: &'a Ctx<'a>,
        identity: Digest,
        fields: Vec<Field>,
        witnesses: Witnesses,
        viewpoints: usize,
    ) -> Self {
        Self {
            ctx,
            identity,
            fields,
            witnesses,
            done: 0,
            total: viewpoints as u64,
        }
    }

    /// Returns the maps of a viewpoint.
    fn maps(&self, place: &Viewpoint) -> Result<Maps, StageError> {
        let renders = self.renders(place)?;
        maps(self.ctx, &renders, &|surfaces| {
            self.witnesses.visibilities(place, surfaces)
        })
    }

    /// Returns the render of every member at a viewpoint.
    fn renders(&self, place: &Viewpoint) -> Result<Vec<Render>, StageError> {
        let fields = self.fields.iter();
        fields
            .map(|field| render_view(self.ctx, field, &place.camera, &place.cam_from_world))
            .collect()
    }

    /// Returns the next maps of a journal over the viewpoints.
    fn next_maps(&self, journal: &mut Journal<'_>, place: &Viewpoint) -> Result<Maps, StageError> {
        let (width, height) = (place.camera.width, place.camera.height);
        journal.piece_of(|maps: &Maps| maps.are_whole(width, height), || self.maps(place))
    }

    fn journal(&self) -> Journal<'a> {
        Journal::new(self.ctx, "maps", self.identity)
    }

    /// Reports that a viewpoint is done.
    fn passed(&mut self, place: &Viewpoint) {
        self.done += 1;
        let note = format!("render {}", place.name);
        self.ctx.progress.at(self.done, self.total, &note);
    }

    /// Makes the maps of every viewpoint and returns their figures.
    pub fn studies(&mut self, views: &[MapView], scene: &Scene) -> Result<Vec<ViewStudy>, StageError> {
        let ctx = self.ctx;
        let mut journal = self.journal();
        let mut studies = Vec::with_capacity(views.len());
        for view in views {
            let maps = self.next_maps(&mut journal, &view.place)?;
            let image = view.image(ctx)?;
            let truth = view.truth(image.as_ref());
            studies.push(study(&view.place, &maps, truth.as_ref(), &scene.points)?);
            self.passed(&view.place);
        }
        journal.end();
        Ok(studies)
    }

    /// Draws and stores the maps of every viewpoint.
    pub fn put_views(
        &self,
        views: &[MapView],
        scales: &Scales,
        outputs: &mut Outputs,
    ) -> Result<(), StageError> {
        let ctx = self.ctx;
        let mut known = self.journal();
        let mut journal = Journal::new(ctx, "drawings", self.identity);
        for view in views {
            let maps = self.next_maps(&mut known, &view.place)?;
            let of_view = journal.piece_of(
                |stored: &Outputs| stored.values().all(|digest| ctx.blobs.contains(digest)),
                || {
                    let mut stored = Outputs::new();
                    let image = view.image(ctx)?;
                    let truth = view.truth(image.as_ref());
                    scales.put_view(ctx, &view.place.name, &maps, truth.as_ref(), &mut stored)?;
                    if let Some(photo) = &view.photo {
                        stored.insert(format!("{MAPS}{}-photo.png", view.place.name), photo.digest);
                    }
                    Ok(stored)
                },
            )?;
            outputs.extend(of_view);
        }
        journal.end();
        Ok(())
    }
}
