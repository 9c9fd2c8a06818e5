//! Digests: names of byte strings and keys of actions, and the digest by which others know a byte string.

use std::{fmt, io, str::FromStr};

use serde::{Deserialize, Deserializer, Serialize, Serializer, de::Error as _};

/// A blake3 digest of 32 bytes: of a blob, or of the content of a key.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Digest([u8; 32]);

/// A SHA-256 digest of 32 bytes: how archives, bags and signatures name a byte string. Nothing in the store is found by it.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Sha256([u8; 32]);

/// The text is not 64 hexadecimal digits.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[error("`{0}` is not a digest of 64 hexadecimal digits")]
pub struct ParseDigestError(String);

impl Digest {
    /// Returns the digest of a byte string.
    pub fn from_content(bytes: &[u8]) -> Self {
        Self(*blake3::hash(bytes).as_bytes())
    }

    /// Returns the digest of all bytes of a reader, and their length, without holding them.
    ///
    /// # Errors
    /// Returns the error of the reader.
    pub fn from_reader(reader: impl io::Read) -> io::Result<(Self, u64)> {
        let mut hasher = blake3::Hasher::new();
        hasher.update_reader(reader)?;
        Ok((Self(*hasher.finalize().as_bytes()), hasher.count()))
    }

    /// Wraps the 32 bytes of a digest.
    pub const fn from_bytes(bytes: [u8; 32]) -> Self {
        Self(bytes)
    }

    /// Returns the 32 bytes.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }

    /// Returns the first 12 hexadecimal digits, for messages.
    pub fn short(&self) -> String {
        self.to_string()[..12].to_owned()
    }
}

impl Sha256 {
    /// Returns the digest of a byte string.
    pub fn from_content(bytes: &[u8]) -> Self {
        Self::from_ring(&ring::digest::digest(&ring::digest::SHA256, bytes))
    }

    fn from_ring(digest: &ring::digest::Digest) -> Self {
        let mut whole = [0; 32];
        whole.copy_from_slice(digest.as_ref());
        Self(whole)
    }

    /// Returns the 32 bytes.
    pub const fn as_bytes(&self) -> &[u8; 32] {
        &self.0
    }
}

/// A reader that gives the digest of what was read through it.
pub struct Sha256Reader<R> {
    reader: R,
    context: ring::digest::Context,
}

impl<R: io::Read> Sha256Reader<R> {
    /// Returns a reader that gives what this one gives.
    pub fn new(reader: R) -> Self {
        Self {
            reader,
            context: ring::digest::Context::new(&ring::digest::SHA256),
        }
    }

    /// Returns the digest of all bytes read.
    pub fn finish(self) -> Sha256 {
        Sha256::from_ring(&self.context.finish())
    }
}

impl<R: io::Read> io::Read for Sha256Reader<R> {
    fn read(&mut self, buffer: &mut [u8]) -> io::Result<usize> {
        let count = self.reader.read(buffer)?;
        self.context.update(&buffer[..count]);
        Ok(count)
    }
}

/// Writes and reads a digest as 64 hexadecimal digits.
macro_rules! as_text {
    ($type:ident) => {
        impl fmt::Display for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                self.0.iter().try_for_each(|byte| write!(f, "{byte:02x}"))
            }
        }

        impl fmt::Debug for $type {
            fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                write!(
                    f,
                    concat!(stringify!($type), "({})"),
                    &self.to_string()[..12]
                )
            }
        }

        impl FromStr for $type {
            type Err = ParseDigestError;

            fn from_str(text: &str) -> Result<Self, Self::Err> {
                let bytes = blake3::Hash::from_hex(text).map_err(|_| ParseDigestError(text.to_owned()))?;
                Ok(Self(*bytes.as_bytes()))
            }
        }

        impl Serialize for $type {
            fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.collect_str(self)
            }
        }

        impl<'de> Deserialize<'de> for $type {
            fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
                let text = String::deserialize(deserializer)?;
                text.parse().map_err(D::Error::custom)
            }
        }
    };
}

as_text!(Digest);
as_text!(Sha256);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_digest_survives_its_text() {
        let digest = Digest::from_content(b"mars");
        assert_eq!(digest.to_string().parse::<Digest>(), Ok(digest));
        assert_eq!(digest.to_string().len(), 64);
    }

    #[test]
    fn a_reader_gives_the_digest_of_its_bytes() {
        for bytes in [vec![], vec![7; 1], vec![3; 200_000]] {
            let (digest, length) = Digest::from_reader(bytes.as_slice()).unwrap();
            assert_eq!(
                (digest, length),
                (Digest::from_content(&bytes), bytes.len() as u64)
            );
        }
    }

    /// The value of FIPS 180-4, appendix B.1.
    #[test]
    fn sha256_is_that_of_the_standard() {
        let abc = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";
        assert_eq!(Sha256::from_content(b"abc").to_string(), abc);
        assert_eq!(abc.parse(), Ok(Sha256::from_content(b"abc")));
        let mut reader = Sha256Reader::new(b"abc".as_slice());
        assert_eq!(io::copy(&mut reader, &mut io::sink()).unwrap(), 3);
        assert_eq!(reader.finish().to_string(), abc);
    }

    #[test]
    fn a_short_or_foreign_text_is_refused() {
        for bad in ["", "00", &"g".repeat(64), &"0".repeat(63), &"0".repeat(65)] {
            assert!(bad.parse::<Digest>().is_err(), "{bad}");
        }
    }
}
