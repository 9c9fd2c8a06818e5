//! How files are opened that others may have made. Only regular files are read, and no more of them than their kind has.

use std::{
    fmt,
    fs::{self, File, Metadata, OpenOptions},
    io::{self, ErrorKind, Read as _},
    path::{Component, Path, PathBuf},
};

/// The kind of a file, which decides how large it may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum FileKind {
    /// A private or public key.
    Key,
    /// A pipeline, a site, a lock file: what people write.
    Settings,
    /// A manifest, a graph, a record, a result.
    Document,
    /// A result or a photo that a user names.
    Result,
    /// What this program left for itself: a checkpoint.
    State,
}

/// What happens with a symbolic link.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Links {
    /// A link is an error: for files from others.
    Refused,
    /// A link to a regular file is that file: in the user's own folders.
    Followed,
}

impl FileKind {
    /// Returns the largest size, bytes.
    pub const fn max_bytes(self) -> u64 {
        match self {
            Self::Key => 64 << 10,
            Self::Settings => 64 << 20,
            Self::Document => 256 << 20,
            Self::Result => 4 << 30,
            Self::State => 16 << 30,
        }
    }
}

/// Reads a file.
///
/// # Errors
/// A file that is absent, no regular file, too large for its kind, or a link where links are refused.
pub fn read(path: &Path, kind: FileKind, links: Links) -> io::Result<Vec<u8>> {
    read_within(path, kind.max_bytes(), links)
}

/// Reads a file of a size up to `max_bytes`. One that is larger is of the kind [`ErrorKind::FileTooLarge`].
///
/// # Errors
/// As [`read`].
pub fn read_within(path: &Path, max_bytes: u64, links: Links) -> io::Result<Vec<u8>> {
    read_unless(path, max_bytes, links, || false)
}

/// As [`read_within`], for as long as `is_stopped` returns false.
///
/// # Errors
/// As [`read`], and [`Stoppable`]'s.
pub fn read_unless(
    path: &Path,
    max_bytes: u64,
    links: Links,
    is_stopped: impl Fn() -> bool,
) -> io::Result<Vec<u8>> {
    let file = open(path, links)?;
    let too_large = |bytes: u64| {
        let what = format!("it has {bytes} bytes, above the limit of {max_bytes}");
        io::Error::new(ErrorKind::FileTooLarge, what)
    };
    let length = file.metadata()?.len();
    if length > max_bytes {
        return Err(too_large(length));
    }
    let mut bytes = Vec::with_capacity((length as usize).min(CHUNK_BYTES));
    // It may grow meanwhile.
    Stoppable::new(file.take(max_bytes.saturating_add(1)), is_stopped).read_to_end(&mut bytes)?;
    if bytes.len() as u64 > max_bytes {
        return Err(too_large(bytes.len() as u64));
    }
    Ok(bytes)
}

/// A reader that ends with an error when `is_stopped` returns true.
pub struct Stoppable<R, F> {
    reader: R,
    is_stopped: F,
}

impl<R: io::Read, F: Fn() -> bool> Stoppable<R, F> {
    /// Returns the reader.
    pub fn new(reader: R, is_stopped: F) -> Self {
        Self { reader, is_stopped }
    }
}

/// Most bytes between two looks at the wish to stop: some milliseconds.
const CHUNK_BYTES: usize = 16 << 20;

impl<R: io::Read, F: Fn() -> bool> io::Read for Stoppable<R, F> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        if (self.is_stopped)() {
            // `Interrupted` would be tried again.
            return Err(io::Error::other("stopped"));
        }
        let most = buffer.len().min(CHUNK_BYTES);
        self.reader.read(&mut buffer[..most])
    }
}

/// Makes the names in a folder survive a power cut, where the system can.
///
/// # Errors
/// Those of the system.
pub fn sync_folder(folder: &Path) -> io::Result<()> {
    if cfg!(unix) {
        File::open(folder)?.sync_all()?;
    }
    Ok(())
}

/// Reads a file of UTF-8 text.
///
/// # Errors
/// As [`read`], and bytes that are not UTF-8.
pub fn read_text(path: &Path, kind: FileKind, links: Links) -> io::Result<String> {
    let bytes = read(path, kind, links)?;
    String::from_utf8(bytes).map_err(|error| io::Error::new(ErrorKind::InvalidData, error.utf8_error()))
}

/// Opens a file for reading. Nothing else than a regular file is opened: a pipe would block, a device may have no end.
///
/// # Errors
/// A file that is absent, no regular file, or a link where links are refused.
pub fn open(path: &Path, links: Links) -> io::Result<File> {
    let found = match links {
        Links::Refused => fs::symlink_metadata(path),
        Links::Followed => fs::metadata(path),
    };
    check_regular(&found?)?;
    let mut options = OpenOptions::new();
    options.read(true);
    // Another file may have taken its place since.
    #[cfg(unix)]
    std::os::unix::fs::OpenOptionsExt::custom_flags(&mut options, flags(links));
    let file = options.open(path)?;
    check_regular(&file.metadata()?)?;
    Ok(file)
}

#[cfg(unix)]
fn flags(links: Links) -> i32 {
    match links {
        Links::Refused => libc::O_NONBLOCK | libc::O_NOFOLLOW,
        Links::Followed => libc::O_NONBLOCK,
    }
}

/// Returns the path of a file below a folder that others may have filled: none of its parts is a link.
///
/// # Errors
/// A link among the parts, a part that leads out of the folder, an absent file.
pub fn below(folder: &Path, relative: &str) -> io::Result<PathBuf> {
    let mut path = folder.to_owned();
    for part in Path::new(relative).components() {
        let Component::Normal(part) = part else {
            return Err(refused("it is outside the folder"));
        };
        path.push(part);
        if fs::symlink_metadata(&path)?.is_symlink() {
            return Err(refused("it is a link"));
        }
    }
    Ok(path)
}

/// Returns whether an error of [`open`] is that there is something else than a regular file.
pub(crate) fn is_irregular(error: &io::Error) -> bool {
    error.kind() == ErrorKind::InvalidInput && error.raw_os_error().is_none()
}

fn check_regular(found: &Metadata) -> io::Result<()> {
    if found.is_symlink() {
        return Err(refused("it is a link"));
    }
    if found.is_file() {
        Ok(())
    } else {
        Err(refused("it is not a regular file"))
    }
}

fn refused(what: impl fmt::Display) -> io::Error {
    io::Error::new(ErrorKind::InvalidInput, what.to_string())
}

#[cfg(test)]
#[cfg(unix)]
mod tests {
    use std::{os::unix::fs::symlink, process::Command};

    use super::*;

    fn fault(path: &Path, links: Links) -> String {
        read(path, FileKind::Key, links).unwrap_err().to_string()
    }

    #[test]
    fn only_regular_files_are_read_and_links_where_they_are_followed() {
        let dir = tempfile::tempdir().unwrap();
        let path = |name: &str| dir.path().join(name);
        fs::write(path("file"), b"bytes").unwrap();
        assert!(
            Command::new("mkfifo")
                .arg(path("pipe"))
                .status()
                .unwrap()
                .success()
        );
        for (link, target) in [
            ("link", path("file")),
            ("to pipe", path("pipe")),
            ("zero", "/dev/zero".into()),
            ("self", path("self")),
            ("nowhere", path("absent")),
        ] {
            symlink(target, path(link)).unwrap();
        }
        let regular = "it is not a regular file";
        for links in [Links::Refused, Links::Followed] {
            assert_eq!(read(&path("file"), FileKind::Key, links).unwrap(), b"bytes");
            assert_eq!(fault(&path("pipe"), links), regular);
            assert_eq!(fault(Path::new("/dev/zero"), links), regular);
            assert_eq!(fault(dir.path(), links), regular);
            let absent = read(&path("absent"), FileKind::Key, links).unwrap_err();
            assert_eq!(absent.kind(), ErrorKind::NotFound);
        }
        for link in ["link", "to pipe", "zero", "self", "nowhere"] {
            assert_eq!(fault(&path(link), Links::Refused), "it is a link");
        }
        assert_eq!(
            read(&path("link"), FileKind::Key, Links::Followed).unwrap(),
            b"bytes"
        );
        assert_eq!(fault(&path("zero"), Links::Followed), regular);
        assert_eq!(fault(&path("to pipe"), Links::Followed), regular);
        assert!(read(&path("self"), FileKind::Key, Links::Followed).is_err());
    }

    #[test]
    fn a_file_is_as_large_as_its_kind_at_most() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("key");
        let file = File::create(&path).unwrap();
        for (bytes, is_read) in [(65_536, true), (65_537, false), (1 << 40, false)] {
            file.set_len(bytes).unwrap();
            assert_eq!(
                read(&path, FileKind::Key, Links::Refused).is_ok(),
                is_read,
                "{bytes}"
            );
        }
        assert_eq!(
            fault(&path, Links::Refused),
            "it has 1099511627776 bytes, above the limit of 65536"
        );
        let error = read_within(&path, 9, Links::Refused).unwrap_err();
        assert_eq!(error.kind(), ErrorKind::FileTooLarge);
    }

    #[test]
    fn reading_ends_soon_after_the_wish_to_stop() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("sparse");
        File::create(&path).unwrap().set_len(1 << 40).unwrap();
        let reads = std::cell::Cell::new(0);
        let is_stopped = || reads.replace(reads.get() + 1) == 3;
        let mut reader = Stoppable::new(open(&path, Links::Refused).unwrap(), is_stopped);
        let error = io::copy(&mut reader, &mut io::sink()).unwrap_err();
        assert_eq!((error.to_string().as_str(), reads.get()), ("stopped", 4));
        let error = read_unless(&path, 1 << 41, Links::Refused, || true).unwrap_err();
        assert_eq!(error.to_string(), "stopped");
    }

    #[test]
    fn no_part_of_a_path_below_a_folder_is_a_link() {
        let dir = tempfile::tempdir().unwrap();
        let folder = dir.path().join("crate");
        fs::create_dir_all(folder.join("data/a")).unwrap();
        fs::write(folder.join("data/a/x"), b"x").unwrap();
        symlink(folder.join("data/a"), folder.join("data/b")).unwrap();
        assert_eq!(below(&folder, "data/a/x").unwrap(), folder.join("data/a/x"));
        for (path, expected) in [
            ("data/b/x", "it is a link"),
            ("../crate/data/a/x", "it is outside the folder"),
            ("/etc/passwd", "it is outside the folder"),
        ] {
            assert_eq!(below(&folder, path).unwrap_err().to_string(), expected);
        }
        // The folder itself is named by the user.
        symlink(&folder, dir.path().join("link")).unwrap();
        assert!(below(&dir.path().join("link"), "data/a/x").is_ok());
    }
}
