//! The inventory of a PDS4 collection: a line per member with `P` or `S` and the LIDVID, without header.

use crate::names::{ProductName, Scheme, version_suffix};

/// Largest inventory that is read: a million members of 130 bytes.
const MAX_BYTES: usize = 128 << 20;
/// Most members that are read.
const MAX_MEMBERS: usize = 2_000_000;
/// Longest identifier, bytes (PDS4 Standards Reference, 6D.2).
const MAX_LID: usize = 255;
/// Number of version suffixes that are tried in addition to the identifier's own version.
const TRIED_VERSIONS: u32 = 9;

/// A product of a collection.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct Member {
    /// Logical identifier, `urn:nasa:pds:bundle:collection:product`.
    pub lid: String,
    /// Version, `1.0`. Empty if a secondary member names none.
    pub version: String,
    /// Whether the member is primary (`P`). A secondary one (`S`) is primary in another collection.
    pub primary: bool,
}

/// Bytes that are not an inventory.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum InventoryError {
    /// Larger than any inventory.
    #[error("an inventory of {0} bytes, at most {MAX_BYTES} are read")]
    TooLarge(usize),
    /// More members than any collection has.
    #[error("an inventory of more than {MAX_MEMBERS} members")]
    TooMany,
    /// No member at all: a collection has at least one.
    #[error("an inventory without members")]
    Empty,
    /// A line that names no product.
    #[error("inventory line {line}: {what}")]
    Line {
        /// Line, from 1.
        line: usize,
        /// What is wrong there.
        what: &'static str,
    },
}

/// Reads an inventory, in its order.
///
/// # Errors
/// See [`InventoryError`]. An inventory that was cut inside an identifier cannot be recognised,
/// except by its version: `::` without `M.m` is refused.
pub fn read(bytes: &[u8]) -> Result<Vec<Member>, InventoryError> {
    if bytes.len() > MAX_BYTES {
        return Err(InventoryError::TooLarge(bytes.len()));
    }
    let bytes = bytes.strip_prefix(b"\xef\xbb\xbf").unwrap_or(bytes);
    let mut members = Vec::new();
    for (index, line) in bytes.split(|byte| *byte == b'\n').enumerate() {
        let line = line.trim_ascii();
        if line.is_empty() {
            continue;
        }
        if members.len() == MAX_MEMBERS {
            return Err(InventoryError::TooMany);
        }
        let member = member(line).map_err(|what| InventoryError::Line {
            line: index + 1,
            what,
        })?;
        members.push(member);
    }
    if members.is_empty() {
        return Err(InventoryError::Empty);
    }
    Ok(members)
}

fn member(line: &[u8]) -> Result<Member, &'static str> {
    let text = std::str::from_utf8(line).map_err(|_| "not ASCII")?;
    let (status, lidvid) = text.split_once(',').ok_or("not two columns")?;
    let primary = match unquoted(status)? {
        "P" | "p" => true,
        "S" | "s" => false,
        _ => return Err("the first column is neither `P` nor `S`"),
    };
    let lidvid = unquoted(lidvid)?;
    let (lid, version) = lidvid.split_once("::").unwrap_or((lidvid, ""));
    if !is_lid(lid) {
        return Err("the second column is not a product identifier");
    }
    let whole = version
        .split_once('.')
        .is_some_and(|(major, minor)| is_number(major) && is_number(minor));
    if !whole && (primary || lidvid.contains("::")) {
        return Err("an identifier without its version");
    }
    Ok(Member {
        lid: lid.to_owned(),
        version: version.to_owned(),
        primary,
    })
}

/// Returns a cell without the blanks and double quotes around it.
fn unquoted(cell: &str) -> Result<&str, &'static str> {
    let cell = cell.trim();
    match cell.strip_prefix('"') {
        Some(inner) => Ok(inner.strip_suffix('"').ok_or("a quote does not end")?.trim()),
        None => Ok(cell),
    }
}

/// Whether a text is `urn:agency:archive:bundle:collection:product` with no part empty.
fn is_lid(lid: &str) -> bool {
    let plain = |byte: u8| byte.is_ascii_alphanumeric() || b"_.-".contains(&byte);
    let parts: Vec<&str> = lid.splitn(7, ':').collect();
    lid.len() <= MAX_LID
        && parts.len() == 6
        && parts[0].eq_ignore_ascii_case("urn")
        && parts
            .iter()
            .all(|part| !part.is_empty() && part.bytes().all(plain))
}

fn is_number(text: &str) -> bool {
    (1..=6).contains(&text.len()) && text.bytes().all(|byte| byte.is_ascii_digit())
}

/// Returns the product's name as its files begin: the identifier's last part in upper case, for Mars 2020 52 characters
/// without the version. `None` for what follows no naming scheme (documents, browse collections of other kinds).
pub fn stem(member: &Member) -> Option<String> {
    let tail = member.lid.rsplit(':').next()?.to_ascii_uppercase();
    let name = ProductName::read(&tail)?;
    (name.id.len() == tail.len() && name.version.len() < 2).then_some(tail)
}

/// Returns the possible names of its files, likeliest first. For Mars 2020 these are the stem with the identifier's
/// version as two characters, then the first nine versions, newest first. For other schemes it is the stem.
pub fn file_stems(member: &Member) -> Vec<String> {
    let Some(stem) = stem(member) else {
        return Vec::new();
    };
    if ProductName::read(&stem).is_none_or(|name| name.scheme != Scheme::M2020) {
        return vec![stem];
    }
    let major = member
        .version
        .split('.')
        .next()
        .and_then(|major| major.parse().ok());
    let mut versions: Vec<u32> = major.into_iter().collect();
    versions.extend(
        (1..=TRIED_VERSIONS)
            .rev()
            .filter(|version| Some(*version) != major),
    );
    let suffixes = versions.into_iter().filter_map(version_suffix);
    suffixes.map(|suffix| format!("{stem}{suffix}")).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const ZLF: &str = "urn:nasa:pds:mars2020_mastcamz_ops_calibrated:data:\
                       zlf_1737_0821123689_910rad_n0830000zcam00091_1100lmj";

    fn one(line: &str) -> Member {
        read(line.as_bytes()).unwrap().remove(0)
    }

    #[test]
    fn members_are_read_in_their_order() {
        let text = format!(
            "\u{feff}P,{ZLF}::1.0\r\n\r\n\"S\" , \"urn:nasa:pds:a:b:c::12.3\"\r\n  \nS,urn:nasa:pds:a:b:d"
        );
        let members = read(text.as_bytes()).unwrap();
        let of = |lid: &str, version: &str, primary| Member {
            lid: lid.to_owned(),
            version: version.to_owned(),
            primary,
        };
        assert_eq!(
            members,
            [
                of(ZLF, "1.0", true),
                of("urn:nasa:pds:a:b:c", "12.3", false),
                of("urn:nasa:pds:a:b:d", "", false)
            ]
        );
    }

    #[test]
    fn what_is_no_member_is_refused_with_its_line() {
        for (bad, part) in [
            ("x", "not two columns"),
            ("Member Status,LIDVID", "neither"),
            ("P;urn:nasa:pds:a:b:c::1.0", "not two columns"),
            ("P,", "not a product identifier"),
            ("P,urn:nasa:pds:a:b::1.0", "not a product identifier"),
            ("P,urn:nasa:pds:a:b:c:d::1.0", "not a product identifier"),
            ("P,urn:nasa:pds:a::c::1.0", "not a product identifier"),
            ("P,urn:nasa:pds:a:b:../c::1.0", "not a product identifier"),
            ("P,urn:nasa:pds:a:b:c", "version"),
            ("P,urn:nasa:pds:a:b:c::", "version"),
            ("P,urn:nasa:pds:a:b:c::1", "version"),
            ("P,urn:nasa:pds:a:b:c::1.", "version"),
            ("S,urn:nasa:pds:a:b:c::", "version"),
            ("P,urn:nasa:pds:a:b:c::1.0,x", "version"),
            ("P,\"urn:nasa:pds:a:b:c::1.0", "quote"),
            ("<html>403</html>", "not two columns"),
        ] {
            let error = read(format!("P,urn:nasa:pds:a:b:c::1.0\n\n{bad}\n").as_bytes())
                .unwrap_err()
                .to_string();
            assert!(
                error.starts_with("inventory line 3: ") && error.contains(part),
                "{bad}: {error}"
            );
        }
        assert_eq!(
            read(b"P,\xff"),
            Err(InventoryError::Line {
                line: 1,
                what: "not ASCII"
            })
        );
        assert_eq!(read(b"\r\n"), Err(InventoryError::Empty));
        assert_eq!(read(b""), Err(InventoryError::Empty));
    }

    /// The identifier and the file name of the label in the data folder.
    #[test]
    fn an_identifier_gives_the_name_of_its_file() {
        let member = one(&format!("P,{ZLF}::1.0"));
        let stem = stem(&member).unwrap();
        assert_eq!(stem, "ZLF_1737_0821123689_910RAD_N0830000ZCAM00091_1100LMJ");
        let names = file_stems(&member);
        assert_eq!(names[0], format!("{stem}01"));
        assert_eq!(
            (names[1].as_str(), names.len()),
            (format!("{stem}09").as_str(), 9)
        );
        let newer = file_stems(&one(&format!("P,{ZLF}::13.0")));
        assert_eq!(
            (newer[0].as_str(), newer.len()),
            (format!("{stem}13").as_str(), 10)
        );
    }

    #[test]
    fn other_missions_have_one_name_and_documents_none() {
        let thumbnail = one("P,urn:nasa:pds:msl_mmm:data_mslmst:3778ml1037770010808163i01_dxxx::1.0");
        assert_eq!(file_stems(&thumbnail), ["3778ML1037770010808163I01_DXXX"]);
        for other in [
            "S,urn:nasa:pds:msl_mmm:document:sis",
            "P,urn:nasa:pds:a:data:x::1.0",
        ] {
            let member = one(other);
            assert_eq!((stem(&member), file_stems(&member).len()), (None, 0), "{other}");
        }
    }
}
