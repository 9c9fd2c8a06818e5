//! Asks an archive on a server for one thing of each kind that is read, and compares it with what the readers expect.
//!
//! ```text
//! questions.rs  one question at a time, and what its answer came to
//! product.rs    label and picture of one product
//! ```
//! Which pages there are is in `kinds/`, next to what lists them for a run. Nothing is stored.

mod product;
mod questions;

pub(crate) use self::questions::{Absence, Checkup, Question, Reading};
