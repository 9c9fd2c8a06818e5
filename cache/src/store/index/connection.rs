//! Connections to the index file, and what their errors mean.

use std::path::Path;

use rusqlite::{Connection, ErrorCode, OpenFlags, config::DbConfig};

use super::tables;

/// Pages a connection that writes keeps in memory, in KiB.
const CACHE_KIB: i64 = 8 << 10;
/// Length to which the log is cut after a checkpoint, in bytes.
const LOG_BYTES: i64 = 16 << 20;

/// Why the index file gives no answer.
#[derive(Debug)]
pub(super) enum Trouble {
    /// Another program holds a lock.
    Busy,
    /// The file is damaged.
    Broken(String),
    /// The file cannot be written or opened (a full disk, no permission).
    Unusable(String),
}

impl From<rusqlite::Error> for Trouble {
    fn from(error: rusqlite::Error) -> Self {
        let message = error.to_string();
        match error.sqlite_error_code() {
            Some(ErrorCode::DatabaseBusy | ErrorCode::DatabaseLocked) => Self::Busy,
            Some(
                ErrorCode::DiskFull
                | ErrorCode::ReadOnly
                | ErrorCode::PermissionDenied
                | ErrorCode::CannotOpen
                | ErrorCode::OutOfMemory,
            ) => Self::Unusable(message),
            _ => Self::Broken(message),
        }
    }
}

/// The identity of a file, which a file that replaces it does not have.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct FileId(u64, u64);

impl FileId {
    /// Returns the identity of the file of this name, or `None` if there is no such file.
    #[cfg(unix)]
    pub(super) fn from_path(path: &Path) -> Option<Self> {
        use std::os::unix::fs::MetadataExt;
        let meta = std::fs::metadata(path).ok()?;
        Some(Self(meta.dev(), meta.ino()))
    }

    /// A file that is open is never replaced on this system.
    #[cfg(not(unix))]
    pub(super) fn from_path(path: &Path) -> Option<Self> {
        path.exists().then_some(Self(0, 0))
    }
}

/// An open index file.
pub(super) struct Handle {
    pub(super) connection: Connection,
    pub(super) file: FileId,
}

impl Handle {
    /// Opens the file for reading and writing.
    pub(super) fn open(path: &Path) -> Result<Self, Trouble> {
        let flags = OpenFlags::SQLITE_OPEN_READ_WRITE | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        let connection = Connection::open_with_flags(path, flags)?;
        if connection.is_readonly(rusqlite::MAIN_DB)? {
            return Err(Trouble::Unusable("it can only be read".to_owned()));
        }
        // Waits are the caller's, so that they can be interrupted.
        connection.busy_timeout(std::time::Duration::ZERO)?;
        configure(&connection)?;
        check(connection, path)
    }

    /// Opens the file for reading, with no write of any kind.
    pub(super) fn open_immutable(path: &Path) -> Result<Self, Trouble> {
        let flags =
            OpenFlags::SQLITE_OPEN_READ_ONLY | OpenFlags::SQLITE_OPEN_URI | OpenFlags::SQLITE_OPEN_NO_MUTEX;
        check(Connection::open_with_flags(uri(path), flags)?, path)
    }

    /// Creates the file with empty tables.
    pub(super) fn create(path: &Path) -> Result<Self, Trouble> {
        let connection = Connection::open(path)?;
        connection.busy_timeout(std::time::Duration::ZERO)?;
        configure(&connection)?;
        tables::create(&connection)?;
        check(connection, path)
    }
}

fn check(connection: Connection, path: &Path) -> Result<Handle, Trouble> {
    // Else SQLite plans each look-up again for its digest, which takes longer than the look-up.
    connection.set_db_config(DbConfig::SQLITE_DBCONFIG_ENABLE_QPSG, true)?;
    let version = tables::version(&connection)?;
    if version != tables::VERSION {
        return Err(Trouble::Broken(format!("its tables are of version {version}")));
    }
    match FileId::from_path(path) {
        Some(file) => Ok(Handle { connection, file }),
        None => Err(Trouble::Broken("it has been removed".to_owned())),
    }
}

/// Requests a write-ahead log. On a file system without support for it, SQLite keeps another journal.
fn configure(connection: &Connection) -> Result<(), Trouble> {
    connection.query_row("PRAGMA journal_mode = WAL", [], |_| Ok(()))?;
    connection.pragma_update(None, "synchronous", "NORMAL")?;
    connection.pragma_update(None, "cache_size", -CACHE_KIB)?;
    connection.pragma_update(None, "journal_size_limit", LOG_BYTES)?;
    Ok(())
}

/// Returns a path as the URI of a file that nobody changes.
fn uri(path: &Path) -> String {
    let mut uri = "file:".to_owned();
    for byte in path.to_string_lossy().bytes() {
        match byte {
            b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'/' | b'.' | b'-' | b'_' | b'~' => {
                uri.push(byte as char);
            }
            other => uri.push_str(&format!("%{other:02x}")),
        }
    }
    uri.push_str("?immutable=1");
    uri
}
