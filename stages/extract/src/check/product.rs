//! Label and picture of one product.

use marf_pds::{Label, ProductName, join_key, raw};
use marf_scene::Photo;
use marf_stage::{OriginKind, StageError};
use md5::{Digest as _, Md5};

use super::{Absence, Checkup, Question, Reading};
use crate::archive::{extension, kind, kind_and_reason, read_label, stem};
use crate::remote::catalog::{ListedSol, RemoteFile};

const LABEL: &str = "label";
const PICTURE: &str = "picture";

/// A file of a sol.
#[derive(Clone, Copy)]
struct ListedFile<'a> {
    name: &'a str,
    remote: &'a RemoteFile,
}

impl Checkup<'_> {
    /// Asks for label and picture of one product of a sol, one with a label if there is one.
    ///
    /// # Errors
    /// The wish to stop.
    pub fn product(&mut self, listed: Option<&ListedSol>) -> Result<(), StageError> {
        let picture = listed.and_then(|listed| Some((listed, chosen(listed)?)));
        let Some((listed, picture)) = picture else {
            for what in [LABEL, PICTURE] {
                self.skip(what, "nothing above names a picture that marf takes");
            }
            return Ok(());
        };
        let (beside, sol) = (label_of(listed, picture.name), listed.sol);
        let is_raw = kind(picture.name, &[]) == OriginKind::Raw;
        let label = match beside {
            Some(file) => self.label(file, sol)?,
            // Raw pixels may begin with their label.
            None if is_raw => None,
            None => {
                let reason = format!("no label of `{}` is listed", picture.name);
                self.take::<()>(LABEL.to_owned(), None, Err(reason)).and(None)
            }
        };
        let read = |bytes: &[u8]| reading_of_picture(picture.name, bytes, label.as_ref());
        let attached = self.ask(question(PICTURE, picture.remote), read)?;
        if beside.is_none() && is_raw {
            self.attached_label(picture.name, attached, sol);
        }
        Ok(())
    }

    fn label(&mut self, file: ListedFile<'_>, sol: u32) -> Result<Option<Label>, StageError> {
        let name = file.name;
        let read = |bytes: &[u8]| {
            let label = read_label(kind(name, &[]), bytes)?;
            Ok(reading_of_label(label, name, sol))
        };
        match &file.remote.bytes {
            Some(bytes) => Ok(self.take(LABEL.to_owned(), None, read(bytes))),
            None => self.ask(question(LABEL, file.remote), read),
        }
    }

    /// Checks the label at the head of a picture. `None` if the picture was not read.
    fn attached_label(&mut self, name: &str, attached: Option<Option<Label>>, sol: u32) {
        let what = LABEL.to_owned();
        match attached {
            Some(Some(label)) => drop(self.take(what, None, Ok(reading_of_label(label, name, sol)))),
            Some(None) => {
                let reason = format!("no label of `{name}` is listed, and it does not begin with one");
                self.take::<()>(what, None, Err(reason));
            }
            None => self.skip(LABEL, format!("no label is listed, and `{name}` was not read")),
        }
    }
}

fn question(what: &str, file: &RemoteFile) -> Question {
    Question {
        what: what.to_owned(),
        urls: file.urls.clone(),
        cap_bytes: file.cap_bytes,
        absence: Absence::Differs,
    }
}

fn is_label(name: &str) -> bool {
    matches!(extension(name).as_str(), "xml" | "lbl" | "json")
}

/// Returns the last picture of a sol that has a label, else the last picture.
fn chosen(listed: &ListedSol) -> Option<ListedFile<'_>> {
    let pictures = || listed_files(listed).rev().filter(|file| !is_label(file.name));
    pictures()
        .find(|file| label_of(listed, file.name).is_some())
        .or_else(|| pictures().next())
}

fn label_of<'a>(listed: &'a ListedSol, picture: &str) -> Option<ListedFile<'a>> {
    let of_picture = |name: &str| join_key(stem(name)) == join_key(stem(picture));
    listed_files(listed).find(|file| is_label(file.name) && of_picture(file.name))
}

fn listed_files(listed: &ListedSol) -> impl DoubleEndedIterator<Item = ListedFile<'_>> {
    let files = listed.files.files.iter();
    files.map(|(name, remote)| ListedFile { name, remote })
}

/// Compares a label with what later stages need.
fn reading_of_label(label: Label, name: &str, sol: u32) -> Reading<Label> {
    let mut differs = Vec::new();
    match label.sol {
        None => differs.push("it has no sol".to_owned()),
        Some(own) if own != sol => differs.push(format!("it says sol {own}, its place says sol {sol}")),
        Some(_) => {}
    }
    if label.instrument.is_none() {
        differs.push("it has no instrument".to_owned());
    }
    let camera = |note: &&String| note.starts_with("label has no");
    differs.extend(label.notes.iter().filter(camera).cloned());
    if !differs.is_empty() {
        differs[0] = format!("`{name}`: {}", differs[0]);
    }
    let found = format!(
        "`{name}`: sol {sol}, instrument {}, camera",
        label.instrument.as_deref().unwrap_or_default()
    );
    Reading {
        value: label,
        found,
        differs,
    }
}

/// Decodes a picture and compares it with its label. Returns the label at its head.
fn reading_of_picture(
    name: &str,
    bytes: &[u8],
    beside: Option<&Label>,
) -> Result<Reading<Option<Label>>, String> {
    let product = ProductName::read(stem(name));
    let in_file = |error: String| format!("`{name}`: {error}");
    let (kind, reason) = kind_and_reason(name, bytes);
    let (width, height, attached) = match kind {
        OriginKind::Raw => {
            let developed = raw::develop(product.as_ref(), bytes, beside);
            let developed = developed.map_err(|error| in_file(error.to_string()))?;
            (developed.image.width, developed.image.height, developed.attached)
        }
        OriginKind::Photo => {
            let photo = Photo::decode(bytes).map_err(|error| in_file(error.to_string()))?;
            (photo.image.width, photo.image.height, None)
        }
        other => {
            let reason = reason.unwrap_or_else(|| format!("{other:?}"));
            return Err(in_file(format!("it is not a picture: {reason}")));
        }
    };
    let mut differs = Vec::new();
    if let Some(label) = beside.or(attached.as_ref()) {
        differs.extend(unlike_label(name, bytes, label));
        let mut notes = Vec::new();
        if label.prior.is_some()
            && label
                .fit_camera(product.as_ref(), width, height, &mut notes)
                .is_none()
        {
            differs.extend(notes.pop());
        }
    }
    if !differs.is_empty() {
        differs[0] = in_file(differs[0].clone());
    }
    Ok(Reading {
        found: format!("`{name}`: {width} x {height} pixels, {} bytes", bytes.len()),
        value: attached,
        differs,
    })
}

/// Compares the bytes of a file with size and checksum, where its label has them.
fn unlike_label(name: &str, bytes: &[u8], label: &Label) -> Vec<String> {
    let Some(array) = &label.array else {
        return Vec::new();
    };
    let named = array.file.as_deref();
    if named.is_some_and(|named| !named.eq_ignore_ascii_case(name)) {
        return Vec::new();
    }
    let size = label.file.bytes.filter(|size| *size != bytes.len() as u64);
    let size = size.map(|size| format!("it has {} bytes, its label says {size}", bytes.len()));
    let md5 = label
        .file
        .md5
        .as_ref()
        .map(|md5| (md5, hexadecimal(&Md5::digest(bytes))));
    let md5 = md5.filter(|(said, own)| *said != own);
    let md5 = md5.map(|(said, own)| format!("its MD5 is {own}, its label says {said}"));
    size.into_iter().chain(md5).collect()
}

fn hexadecimal(bytes: &[u8]) -> String {
    bytes.iter().map(|byte| format!("{byte:02x}")).collect()
}
