//! Small JSON objects that are not named by their digest: a line with the digest of the JSON precedes it.

use bytes::Bytes;
use marf_cache::{Digest, Record};
use serde::{Deserialize, Serialize, de::DeserializeOwned};

use crate::trust::Trust;

/// The record of a key, with what belongs to it: whoever reads it need not read the objects to know what they name.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub(crate) struct RemoteRecord {
    pub(crate) record: Record,
    /// Blobs of this result alone.
    pub(crate) blobs: Vec<Digest>,
    /// Keys of its parts and children.
    pub(crate) keys: Vec<Digest>,
}

/// A run, with the results and documents it consists of.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
pub struct RemoteRun {
    /// Name of its pipeline.
    pub pipeline: String,
    /// Start, in seconds since 1970.
    pub started_unix_s: u64,
    /// Keys of its results.
    pub keys: Vec<Digest>,
    /// Blobs that it names in addition to the keys.
    pub blobs: Vec<Digest>,
    /// The run's root, a JSON text, to the byte.
    pub root: String,
}

/// A value that was read, and whether its writer is trusted.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(crate) struct SealedValue<T> {
    pub(crate) value: T,
    /// A writer that is trusted has signed it, or everybody is.
    pub(crate) is_believed: bool,
    /// Somebody has signed it.
    pub(crate) is_signed: bool,
}

impl<T> SealedValue<T> {
    /// Returns whether writing it again adds a trusted signature: it has no such signature, and this program has a
    /// key.
    pub(crate) fn should_be_signed(&self, trust: &Trust) -> bool {
        trust.key.is_some() && !(self.is_signed && self.is_believed)
    }
}

/// Returns a value as JSON behind its digest, and behind a signature if there is a key.
pub(crate) fn seal(value: &impl Serialize, trust: &Trust) -> Bytes {
    // Strings, numbers and sorted maps always serialise.
    let json = serde_json::to_vec(value).unwrap_or_default();
    let digest = Digest::from_content(&json);
    let mut line = digest.to_string();
    if let Some(signature) = trust.sign(&digest) {
        line.push(' ');
        line.extend(signature.iter().map(|byte| format!("{byte:02x}")));
    }
    line.push('\n');
    Bytes::from([line.as_bytes(), &json].concat())
}

/// Reads an object that [`seal`] wrote, or returns `None` if it is incomplete.
pub(crate) fn open<T: DeserializeOwned>(bytes: &[u8], trust: &Trust) -> Option<SealedValue<T>> {
    let end = bytes.iter().position(|byte| *byte == b'\n')?;
    let (line, json) = (bytes.get(..end)?, bytes.get(end + 1..)?);
    let line = std::str::from_utf8(line).ok()?;
    let (digest, signature) = match line.split_once(' ') {
        Some((digest, signature)) => (digest, Some(bytes_of(signature)?)),
        None => (line, None),
    };
    let digest: Digest = digest.parse().ok()?;
    if Digest::from_content(json) != digest {
        return None;
    }
    Some(SealedValue {
        value: serde_json::from_slice(json).ok()?,
        is_believed: trust.believes(&digest, signature.as_deref()),
        is_signed: signature.is_some(),
    })
}

/// Reads bytes from their hexadecimal digits.
fn bytes_of(digits: &str) -> Option<Vec<u8>> {
    let pairs = digits.as_bytes().chunks(2);
    pairs
        .map(|pair| u8::from_str_radix(std::str::from_utf8(pair).ok()?, 16).ok())
        .collect()
}

#[cfg(test)]
mod tests {
    use marf_keys::SigningKey;

    use super::*;

    #[test]
    fn a_sealed_value_comes_back_whole_or_not_at_all() {
        let run = RemoteRun {
            pipeline: "mars\n".to_owned(),
            started_unix_s: 7,
            keys: vec![Digest::from_content(b"key")],
            blobs: Vec::new(),
            root: "{}".to_owned(),
        };
        let trust = Trust::default();
        let bytes = seal(&run, &trust);
        assert_eq!(open(&bytes, &trust).map(|opened| opened.value), Some(run));
        for at in 0..bytes.len() {
            let mut flipped = bytes.to_vec();
            flipped[at] ^= 1;
            assert_eq!(open::<RemoteRun>(&flipped, &trust), None, "flipped at {at}");
            assert_eq!(open::<RemoteRun>(&bytes[..at], &trust), None, "cut at {at}");
        }
    }

    /// Test 1 of RFC 8032, section 7.1, in PKCS#8.
    const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
        MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
        -----END PRIVATE KEY-----\n";

    #[test]
    fn a_trusted_writer_alone_is_believed_and_no_altered_signature() {
        let key = || SigningKey::from_pem(PRIVATE_PEM).unwrap();
        let writer = Trust {
            key: Some(key()),
            ..Trust::default()
        };
        let reader = Trust {
            writers: vec![key().public()],
            ..Trust::default()
        };
        let value = vec![7];
        let believed =
            |bytes: &[u8], trust: &Trust| open::<Vec<u32>>(bytes, trust).map(|opened| opened.is_believed);
        let (signed, bare) = (seal(&value, &writer), seal(&value, &Trust::default()));
        assert_eq!(believed(&signed, &reader), Some(true));
        assert_eq!(believed(&bare, &reader), Some(false));
        assert_eq!(believed(&signed, &Trust::default()), Some(true));
        let end = signed.iter().position(|byte| *byte == b'\n').unwrap();
        for at in 65..end {
            let mut altered = signed.to_vec();
            altered[at] = if altered[at] == b'0' { b'1' } else { b'0' };
            assert_eq!(believed(&altered, &reader), Some(false), "digit {at}");
        }
        // A signature of another value does not carry over.
        let other = seal(&vec![8], &Trust::default());
        let forged = [&other[..64], &signed[64..=end], &other[65..]].concat();
        assert_eq!(believed(&forged, &reader), Some(false));
    }
}
