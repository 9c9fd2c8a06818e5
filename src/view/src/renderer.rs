//! Renders one picture at a time. Of the views of one page the newest wins.

use std::collections::HashMap;
use std::num::NonZero;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use parking_lot::Mutex;
use tokio::sync::{Semaphore, mpsc};

use crate::ViewError;
use crate::field::SharedField;
use crate::frames::{DIVISORS, FrameError, Shown, View, frame};

/// Pages that are remembered. With more all are forgotten, which stops no picture.
const MOST_VIEWERS: usize = 64;

/// Renders pictures for pages.
pub struct Renderer {
    pool: Arc<rayon::ThreadPool>,
    /// One picture is rendered at a time, on all threads.
    turn: Arc<Semaphore>,
    /// The last request of each page.
    newest: Mutex<HashMap<u64, Arc<AtomicU64>>>,
}

/// A request among those of its page.
#[derive(Clone)]
struct Ticket {
    newest: Arc<AtomicU64>,
    number: u64,
}

impl Ticket {
    fn is_old(&self) -> bool {
        self.newest.load(Ordering::Relaxed) != self.number
    }
}

/// A picture in four sizes, or the sentence why there is none.
pub type Frames = mpsc::Receiver<Result<Vec<u8>, FrameError>>;

impl Renderer {
    /// Returns a renderer of as many threads. Without a number, of one a core.
    ///
    /// # Errors
    /// Threads that cannot be started.
    pub fn new(threads: Option<NonZero<usize>>) -> Result<Self, ViewError> {
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(threads.map_or(0, NonZero::get))
            .thread_name(|index| format!("view-{index}"))
            .build()
            .map_err(|error| ViewError::Threads(error.to_string()))?;
        Ok(Self {
            pool: Arc::new(pool),
            turn: Arc::new(Semaphore::new(1)),
            newest: Mutex::default(),
        })
    }

    /// Runs work on the threads that render, in its turn. `None` if the server ends.
    pub async fn run<T: Send + 'static>(&self, work: impl FnOnce() -> T + Send + 'static) -> Option<T> {
        run(&self.pool, &self.turn, work).await
    }

    /// Renders a view for a page, coarse first. It ends when the receiver is dropped, and when the page
    /// requests another view.
    pub fn frames(&self, viewer: u64, field: SharedField, view: View, shown: Shown) -> Frames {
        let ticket = self.ticket(viewer);
        let (sender, receiver) = mpsc::channel(1);
        let (pool, turn) = (Arc::clone(&self.pool), Arc::clone(&self.turn));
        tokio::spawn(async move {
            for divisor in DIVISORS {
                let (field, view, shown) = (Arc::clone(&field), view.clone(), shown.clone());
                let (ticket, is_gone) = (ticket.clone(), sender.clone());
                let stopped = move || ticket.is_old() || is_gone.is_closed();
                if stopped() {
                    return;
                }
                let made = run(&pool, &turn, move || {
                    frame(&field, &view, &shown, divisor, &stopped)
                })
                .await;
                let Some(made) = made.filter(|made| !matches!(made, Err(FrameError::Stopped))) else {
                    return;
                };
                let is_last = made.is_err();
                if sender.send(made).await.is_err() || is_last {
                    return;
                }
            }
        });
        receiver
    }

    /// Makes a request the newest of its page.
    fn ticket(&self, viewer: u64) -> Ticket {
        let mut viewers = self.newest.lock();
        if viewers.len() >= MOST_VIEWERS && !viewers.contains_key(&viewer) {
            viewers.clear();
        }
        let newest = Arc::clone(viewers.entry(viewer).or_default());
        let number = newest.fetch_add(1, Ordering::Relaxed) + 1;
        Ticket { newest, number }
    }
}

async fn run<T: Send + 'static>(
    pool: &Arc<rayon::ThreadPool>,
    turn: &Arc<Semaphore>,
    work: impl FnOnce() -> T + Send + 'static,
) -> Option<T> {
    let _turn = turn.acquire().await.ok()?;
    let pool = Arc::clone(pool);
    tokio::task::spawn_blocking(move || pool.install(work)).await.ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn of_one_page_the_newest_request_wins_and_others_are_left_alone() {
        let renderer = Renderer::new(NonZero::new(1)).unwrap();
        let (first, other) = (renderer.ticket(1), renderer.ticket(2));
        assert!(!first.is_old() && !other.is_old());
        let second = renderer.ticket(1);
        assert!(first.is_old() && !second.is_old() && !other.is_old());
    }

    #[test]
    fn many_pages_are_forgotten_and_go_on() {
        let renderer = Renderer::new(NonZero::new(1)).unwrap();
        let first = renderer.ticket(0);
        (1..1000).for_each(|viewer| drop(renderer.ticket(viewer)));
        assert!(!first.is_old());
        assert!(renderer.newest.lock().len() <= MOST_VIEWERS);
    }
}
