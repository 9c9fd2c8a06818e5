//! Shared state of all requests: the store, the access checks, and the runs that pages show.

use std::sync::Arc;

use marf_field::Device;
use parking_lot::Mutex;

use crate::access::Access;
use crate::content::Content;
use crate::field::SharedField;
use crate::renderer::Renderer;
use crate::source::Source;
use crate::splats::SplatJob;

/// Shared state of all requests.
pub struct Site {
    /// The store.
    pub source: Arc<dyn Source>,
    /// Who may ask.
    pub access: Access,
    /// Renders pictures.
    pub renderer: Renderer,
    /// The run that is shown, then those that pages opened earlier still show, the last first.
    contents: Mutex<Vec<Arc<Content>>>,
    device: Device,
}

/// Runs that are kept for pages that still show them. Any other run is read again.
const MOST_RUNS: usize = 3;

impl Site {
    /// Returns a site that shows nothing yet.
    pub fn new(source: Arc<dyn Source>, access: Access, renderer: Renderer, device: Device) -> Self {
        Self {
            source,
            access,
            renderer,
            contents: Mutex::default(),
            device,
        }
    }

    /// Returns the runs that pages show, first the one that is shown now.
    pub fn contents(&self) -> Vec<Arc<Content>> {
        self.contents.lock().clone()
    }

    /// Returns the run to show now, which is read if it is another one.
    ///
    /// # Errors
    /// One sentence.
    pub fn refreshed(&self) -> Result<Arc<Content>, String> {
        let newest = self.source.newest()?;
        let mut contents = self.contents.lock();
        let known = contents.iter().position(|content| content.number == newest);
        let content = match known {
            Some(place) => contents.remove(place),
            None => Arc::new(Content::read(self.source.as_ref(), newest)?),
        };
        contents.insert(0, Arc::clone(&content));
        contents.truncate(MOST_RUNS);
        Ok(content)
    }

    /// Returns a field of the run that a page shows, also where another run is shown by now.
    ///
    /// # Errors
    /// One sentence: no such run, or a lost field.
    pub fn field(&self, run: u64, index: usize) -> Result<(Arc<Content>, SharedField), String> {
        let content = self.content_of(run)?;
        let field = content.field(index, self.source.as_ref(), &self.device)?;
        Ok((content, field))
    }

    /// Returns the splats of a field as [`Site::field`].
    ///
    /// # Errors
    /// As [`Site::field`].
    pub fn splats(&self, run: u64, index: usize) -> Result<Arc<SplatJob>, String> {
        self.content_of(run)?.splats(index, &self.source)
    }

    fn content_of(&self, run: u64) -> Result<Arc<Content>, String> {
        let mut contents = self.contents.lock();
        if let Some(content) = contents.iter().find(|content| content.number == Some(run)) {
            return Ok(Arc::clone(content));
        }
        let content = Arc::new(Content::read(self.source.as_ref(), Some(run))?);
        contents.push(Arc::clone(&content));
        if contents.len() > MOST_RUNS {
            // The first is the one that is shown, the last the one that is requested.
            contents.remove(1);
        }
        Ok(content)
    }
}
