//! Names of formats that are not read.

use super::decoded::DecodeError;

/// Formats by bytes at a place of the file.
const FORMATS: [(usize, &[u8], &str); 22] = [
    (4, b"ftypheic", "HEIC"),
    (4, b"ftypheix", "HEIC"),
    (4, b"ftyphevc", "HEIC"),
    (4, b"ftypheim", "HEIC"),
    (4, b"ftypheis", "HEIC"),
    (4, b"ftypmif1", "HEIF"),
    (4, b"ftypmsf1", "HEIF"),
    (4, b"ftypavif", "AVIF"),
    (4, b"ftypavis", "AVIF"),
    (4, b"ftypcrx ", "CR3 (undeveloped pixels of a Canon)"),
    (4, b"ftyp", "a film (MP4, MOV)"),
    (0, b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (0, b"\xff\x4f\xff\x51", "JPEG 2000"),
    (0, b"\0\0\0\x0cJXL ", "JPEG XL"),
    (0, b"\xff\x0a", "JPEG XL"),
    (0, b"BM", "BMP"),
    (0, b"8BPS", "a Photoshop document"),
    (0, b"FUJIFILMCCD-RAW", "RAF (undeveloped pixels of a Fujifilm)"),
    (0, b"SIMPLE  =", "FITS"),
    (0, b"#?RADIANCE", "Radiance HDR"),
    (0, b"\x76\x2f\x31\x01", "OpenEXR"),
    (0, b"%PDF", "PDF"),
];

/// Returns why bytes of no format that is read are refused.
pub(super) fn error(bytes: &[u8]) -> DecodeError {
    if bytes.is_empty() {
        return DecodeError::Empty;
    }
    let fits =
        |(at, magic, _): &&(usize, &[u8], &str)| bytes.get(*at..).is_some_and(|rest| rest.starts_with(magic));
    if let Some((_, _, name)) = FORMATS.iter().find(fits) {
        return DecodeError::Foreign(name);
    }
    let start = bytes.iter().take(8).map(|byte| format!("{byte:02x}")).collect();
    DecodeError::Format { start }
}
