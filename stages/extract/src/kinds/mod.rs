//! The table of kinds of archives. A new kind is a file here, and one row.

mod demo;
mod feed;
mod folder;
mod mission;
mod pds;

use crate::archive::kind::{ArchiveDef, define};

/// Every kind of archive, by name.
pub static ARCHIVES: &[ArchiveDef] = &[
    define::<demo::Demo>(),
    define::<feed::Feed>(),
    define::<folder::Folder>(),
    define::<pds::Pds>(),
];
