//! What a file is, by its name and first bytes.

use marf_stage::OriginKind;

/// Returns the folder part of a relative name, without the slash.
pub(crate) fn folder(name: &str) -> &str {
    name.rsplit_once('/').map_or("", |(folder, _)| folder)
}

/// Returns a name's last part without its extension.
pub(crate) fn stem(name: &str) -> &str {
    let file = name.rsplit('/').next().unwrap_or(name);
    file.rsplit_once('.').map_or(file, |(stem, _)| stem)
}

/// Returns a name's extension in lower case, empty if there is none.
pub(crate) fn extension(name: &str) -> String {
    let file = name.rsplit('/').next().unwrap_or(name);
    file.rsplit_once('.')
        .map_or_else(String::new, |(_, extension)| extension.to_ascii_lowercase())
}

/// Folders of thumbnails and of other files that systems leave next to photos.
const SYSTEM_FOLDERS: [(&str, &str); 8] = [
    ("@eadir", "a thumbnail of a Synology disk station"),
    (".@__thumb", "a thumbnail of a QNAP disk station"),
    (".thumbnails", "a thumbnail of the desktop"),
    (".thumbs", "a thumbnail of the desktop"),
    (".picasaoriginals", "an original that Picasa put away"),
    ("__macosx", "an attribute that macOS packed"),
    (".appledouble", "an attribute that macOS left"),
    ("$recycle.bin", "a file that was deleted"),
];
/// Files that systems leave next to photos.
const SYSTEM_FILES: [(&str, &str); 5] = [
    ("thumbs.db", "thumbnails of Windows"),
    ("ehthumbs.db", "thumbnails of Windows"),
    ("desktop.ini", "folder settings of Windows"),
    (".ds_store", "folder settings of macOS"),
    (".picasa.ini", "folder settings of Picasa"),
];
/// Start of the names of files that hold what macOS could not store with `NAME`.
const APPLE_DOUBLE: &str = "._";

/// Describes a file that an operating system or device left next to photos. `None` for any other file.
pub(crate) fn left_by_a_system(name: &str) -> Option<&'static str> {
    let known = |table: &'static [(&str, &str)], part: &str| {
        table
            .iter()
            .find(|(known, _)| part.eq_ignore_ascii_case(known))
            .map(|(_, what)| *what)
    };
    let mut parts = name.split('/').rev();
    let file = parts.next().unwrap_or_default();
    known(&SYSTEM_FILES, file)
        .or_else(|| parts.find_map(|part| known(&SYSTEM_FOLDERS, part)))
        .or_else(|| {
            file.starts_with(APPLE_DOUBLE)
                .then_some("an attribute that macOS left")
        })
}

/// Whether a hidden file or folder is one that systems are known to leave, so that it is reported.
pub(crate) fn is_system_name(part: &str) -> bool {
    let is = |table: &[(&str, &str)]| table.iter().any(|(known, _)| part.eq_ignore_ascii_case(known));
    part.starts_with(APPLE_DOUBLE) || is(&SYSTEM_FOLDERS) || is(&SYSTEM_FILES)
}

/// Extensions of undeveloped pixels as cameras write them.
const CAMERA_RAW: [&str; 9] = ["3fr", "arw", "cr2", "dng", "iiq", "nef", "orf", "pef", "rw2"];

/// Whether bytes begin as a PNM: `P1` to `P6`, white space, and a number or a comment.
fn is_pnm(bytes: &[u8]) -> bool {
    matches!(bytes, [b'P', b'1'..=b'6', space, next, ..]
        if space.is_ascii_whitespace() && (next.is_ascii_digit() || *next == b'#'))
}

/// Returns the kind of a file by its first bytes, else by its name.
pub(crate) fn kind(name: &str, bytes: &[u8]) -> OriginKind {
    kind_and_reason(name, bytes).0
}

/// Returns the kind of a file by its first bytes, else by its name, and why it is not taken if it is of no kind that is.
pub(crate) fn kind_and_reason(name: &str, bytes: &[u8]) -> (OriginKind, Option<String>) {
    let other = |reason: String| (OriginKind::Other, Some(reason));
    if let Some(reason) = left_by_a_system(name) {
        return other(reason.to_owned());
    }
    let extension = extension(name);
    if CAMERA_RAW.contains(&extension.as_str()) {
        // They are TIFFs, whose first page is a thumbnail.
        return other(format!(
            "undeveloped pixels of a camera (`.{extension}`): save them as TIFF, PNG or JPEG"
        ));
    }
    let magic: [&[u8]; 8] = [
        b"\xff\xd8\xff",
        b"\x89PNG\r\n\x1a\n",
        b"GIF8",
        b"RIFF",
        b"II*\0",
        b"MM\0*",
        b"II+\0",
        b"MM\0+",
    ];
    if magic.iter().any(|magic| bytes.starts_with(magic)) || is_pnm(bytes) {
        return (OriginKind::Photo, None);
    }
    let kind = match extension.as_str() {
        "jpg" | "jpeg" | "png" | "webp" | "gif" | "tif" | "tiff" | "pnm" | "pbm" | "pgm" | "ppm" | "pam"
        | "bmp" | "jp2" | "j2k" | "jxl" | "heic" | "heif" | "avif" => OriginKind::Photo,
        "img" | "vic" | "vicar" => OriginKind::Raw,
        "xml" => OriginKind::Pds4,
        "json" => OriginKind::Feed,
        "lbl" => OriginKind::Odl,
        "dat" if marf_pds::dat::is_compressed(bytes) => OriginKind::Raw,
        "dat" => {
            let reason = "no photo and no label: a `.dat` without the header of Mastcam, MAHLI or MARDI";
            return other(reason.to_owned());
        }
        "" => return other("no photo and no label: unknown first bytes, no extension".to_owned()),
        unknown => return other(format!("no photo and no label: `.{unknown}`")),
    };
    (kind, None)
}
