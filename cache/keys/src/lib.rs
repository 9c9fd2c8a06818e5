//! Ed25519 keys from PEM files: the signing keys and the trusted public keys of results, runs and statements.

use base64::Engine as _;
use base64::engine::general_purpose::STANDARD;
use marf_cache::{Sha256, canonical_json};
use ring::rand::{SecureRandom as _, SystemRandom};
use ring::signature::{ED25519, Ed25519KeyPair, KeyPair as _, UnparsedPublicKey};
use rustls_pki_types::pem::{self, SectionKind};
use serde_json::json;

/// The DER bytes before the 32 bytes of an Ed25519 key in a SubjectPublicKeyInfo (RFC 8410, section 4).
const SPKI_HEAD: [u8; 12] = [
    0x30, 0x2a, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x03, 0x21, 0x00,
];
/// The DER bytes before the 32 bytes of an Ed25519 key in a PrivateKeyInfo (RFC 8410, section 7).
const PKCS8_HEAD: [u8; 16] = [
    0x30, 0x2e, 0x02, 0x01, 0x00, 0x30, 0x05, 0x06, 0x03, 0x2b, 0x65, 0x70, 0x04, 0x22, 0x04, 0x20,
];
/// Labels of private keys that only a passphrase opens.
const ENCRYPTED: [&str; 2] = ["BEGIN ENCRYPTED PRIVATE KEY", "Proc-Type: 4,ENCRYPTED"];

/// A private key that signs.
pub struct SigningKey(Ed25519KeyPair);

/// A public key that verifies.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct PublicKey([u8; 32]);

/// A text that holds no usable key.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum KeyError {
    /// The key needs a passphrase.
    #[error("the key is locked with a passphrase")]
    Passphrase,
    /// A key in the form of OpenSSH.
    #[error("the key is in OpenSSH format, but an Ed25519 key in PEM (PKCS#8) is needed")]
    OpenSsh,
    /// No such section.
    #[error("it has no `{wanted}` section")]
    Absent {
        /// The label of the section.
        wanted: &'static str,
    },
    /// The system has no random numbers.
    #[error("the system has no random numbers")]
    Random,
    /// A key of another algorithm, or damaged.
    #[error("its `{wanted}` is not an Ed25519 key")]
    NotEd25519 {
        /// The label of the section.
        wanted: &'static str,
    },
}

impl KeyError {
    /// Returns what the user can do about it.
    pub fn hint(&self) -> &'static str {
        match self {
            Self::Passphrase => {
                "`openssl pkey -in KEY.pem -out PLAIN.pem` writes a copy without a passphrase. Remove it afterwards"
            }
            Self::OpenSsh => NEW_KEY,
            Self::Random => "nothing was written: try again",
            Self::Absent { wanted } | Self::NotEd25519 { wanted } if *wanted == PUBLIC => {
                "`openssl pkey -in KEY.pem -pubout -out PUB.pem` writes the public key of a private one"
            }
            Self::Absent { .. } | Self::NotEd25519 { .. } => NEW_KEY,
        }
    }
}

const NEW_KEY: &str = "`marf key new --out KEY.pem` makes a key";
const PRIVATE: &str = "PRIVATE KEY";
const PUBLIC: &str = "PUBLIC KEY";

impl SigningKey {
    /// Reads an Ed25519 key in PEM (PKCS#8, with or without its public half), as `openssl genpkey -algorithm ed25519`
    /// writes it.
    ///
    /// # Errors
    /// Returns an error if the text has no such key, and [`KeyError::Passphrase`] if the key has a
    /// passphrase.
    pub fn from_pem(text: &str) -> Result<Self, KeyError> {
        if ENCRYPTED.iter().any(|label| text.contains(label)) {
            return Err(KeyError::Passphrase);
        }
        if text.contains("BEGIN OPENSSH PRIVATE KEY") {
            return Err(KeyError::OpenSsh);
        }
        let der = section(text, SectionKind::PrivateKey).ok_or(KeyError::Absent { wanted: PRIVATE })?;
        Ed25519KeyPair::from_pkcs8_maybe_unchecked(&der)
            .map(Self)
            .map_err(|_| KeyError::NotEd25519 { wanted: PRIVATE })
    }

    /// Makes a key, and returns it in PEM, as [`SigningKey::from_pem`] and OpenSSL read it.
    ///
    /// # Errors
    /// A system without random numbers.
    pub fn new_pem() -> Result<String, KeyError> {
        let mut seed = [0; 32];
        SystemRandom::new()
            .fill(&mut seed)
            .map_err(|_| KeyError::Random)?;
        Ok(pem_text(PRIVATE, &[&PKCS8_HEAD[..], &seed].concat()))
    }

    /// Returns the public half.
    pub fn public(&self) -> PublicKey {
        let mut bytes = [0; 32];
        bytes.copy_from_slice(self.0.public_key().as_ref());
        PublicKey(bytes)
    }

    /// Returns the signature of a message: 64 bytes, the same each time (RFC 8032).
    pub fn sign(&self, message: &[u8]) -> Vec<u8> {
        self.0.sign(message).as_ref().to_vec()
    }
}

impl PublicKey {
    /// Reads an Ed25519 public key in PEM (SubjectPublicKeyInfo), as `openssl pkey -pubout` writes it.
    ///
    /// # Errors
    /// A text without such a key.
    pub fn from_pem(text: &str) -> Result<Self, KeyError> {
        let der = section(text, SectionKind::PublicKey).ok_or(KeyError::Absent { wanted: PUBLIC })?;
        let key = der.strip_prefix(&SPKI_HEAD).and_then(|key| key.try_into().ok());
        key.map(Self).ok_or(KeyError::NotEd25519 { wanted: PUBLIC })
    }

    /// Returns the key in PEM, as [`PublicKey::from_pem`] reads it.
    pub fn to_pem(&self) -> String {
        pem_text(PUBLIC, &[&SPKI_HEAD[..], &self.0].concat())
    }

    /// Returns whether the signature is that of this message by this key.
    pub fn verifies(&self, message: &[u8], signature: &[u8]) -> bool {
        UnparsedPublicKey::new(&ED25519, &self.0)
            .verify(message, signature)
            .is_ok()
    }

    /// Returns the name of the key in signatures: the SHA-256 of its canonical JSON, as TUF and in-toto name keys.
    pub fn id(&self) -> Sha256 {
        let public: String = self.0.iter().map(|byte| format!("{byte:02x}")).collect();
        let key = json!({"keytype": "ed25519", "scheme": "ed25519", "keyval": {"public": public}});
        Sha256::from_content(&canonical_json(&key))
    }
}

/// Returns a section of at most 48 bytes, which need one line.
fn pem_text(label: &str, der: &[u8]) -> String {
    format!(
        "-----BEGIN {label}-----\n{}\n-----END {label}-----\n",
        STANDARD.encode(der)
    )
}

/// Returns the bytes of the first section of this kind.
fn section(text: &str, wanted: SectionKind) -> Option<Vec<u8>> {
    let mut rest = text.as_bytes();
    while let Ok(Some((kind, der))) = pem::from_buf(&mut rest) {
        if kind == wanted {
            return Some(der);
        }
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test 1 of RFC 8032, section 7.1, in PKCS#8.
    const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
        MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
        -----END PRIVATE KEY-----\n";
    /// Its public half, d75a980182b10ab7d54bfed3c964073a0ee172f3daa62325af021a68f707511a.
    const PUBLIC_PEM: &str = "-----BEGIN PUBLIC KEY-----\n\
        MCowBQYDK2VwAyEA11qYAYKxCrfVS/7TyWQHOg7hcvPapiMlrwIaaPcHURo=\n\
        -----END PUBLIC KEY-----\n";

    fn key() -> SigningKey {
        SigningKey::from_pem(PRIVATE_PEM).unwrap()
    }

    #[test]
    fn a_signature_is_that_of_the_standard() {
        let expected = "e5564300c360ac729086e2cc806e828a84877f1eb8e5d974d873e065224901555\
            fb8821590a33bacc61e39701cf9b46bd25bf5f0595bbe24655141438e7a100b";
        let signature = key().sign(b"");
        let hex: String = signature.iter().map(|byte| format!("{byte:02x}")).collect();
        assert_eq!(hex, expected);
        let public = PublicKey::from_pem(PUBLIC_PEM).unwrap();
        assert_eq!(key().public(), public);
        assert!(public.verifies(b"", &signature));
        assert!(!public.verifies(b"x", &signature));
        assert!(!public.verifies(b"", &signature[..63]));
    }

    #[test]
    fn a_new_key_signs_and_its_texts_are_read_again() {
        assert_eq!(key().public().to_pem(), PUBLIC_PEM);
        let text = SigningKey::new_pem().unwrap();
        let key = SigningKey::from_pem(&text).unwrap();
        let public = PublicKey::from_pem(&key.public().to_pem()).unwrap();
        assert!(public.verifies(b"x", &key.sign(b"x")));
        assert_ne!(SigningKey::new_pem().unwrap(), text);
        assert_eq!(
            text.lines().nth(1).map(str::len),
            PRIVATE_PEM.lines().nth(1).map(str::len)
        );
    }

    #[test]
    fn what_is_no_key_is_told_by_name() {
        let dashes = |label: &str| format!("-----BEGIN {label}-----\nAAAA\n-----END {label}-----\n");
        for (text, expected) in [
            (dashes("ENCRYPTED PRIVATE KEY"), KeyError::Passphrase),
            (
                "-----BEGIN PRIVATE KEY-----\nProc-Type: 4,ENCRYPTED\n".to_owned(),
                KeyError::Passphrase,
            ),
            (dashes("OPENSSH PRIVATE KEY"), KeyError::OpenSsh),
            (dashes("PRIVATE KEY"), KeyError::NotEd25519 { wanted: PRIVATE }),
            (PUBLIC_PEM.to_owned(), KeyError::Absent { wanted: PRIVATE }),
            (String::new(), KeyError::Absent { wanted: PRIVATE }),
        ] {
            assert_eq!(SigningKey::from_pem(&text).err(), Some(expected), "{text}");
        }
        let wanted = PUBLIC;
        assert_eq!(PublicKey::from_pem(PRIVATE_PEM), Err(KeyError::Absent { wanted }));
        assert_eq!(
            PublicKey::from_pem(&dashes("PUBLIC KEY")),
            Err(KeyError::NotEd25519 { wanted })
        );
    }

    proptest::proptest! {
        #[test]
        fn a_signature_holds_for_its_message_alone(message: Vec<u8>, bit in 0_usize..512) {
            let mut signature = key().sign(&message);
            proptest::prop_assert!(key().public().verifies(&message, &signature));
            signature[bit / 8] ^= 1 << (bit % 8);
            proptest::prop_assert!(!key().public().verifies(&message, &signature));
        }
    }
}
