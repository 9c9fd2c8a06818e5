//! Signed envelopes: DSSE, version 1 (github.com/secure-systems-lab/dsse).

use base64::{Engine as _, engine::general_purpose::STANDARD};
use serde::{Deserialize, Serialize};

use marf_keys::{PublicKey, SigningKey};

/// Payload type of our envelopes: an in-toto statement.
pub const PAYLOAD_TYPE: &str = "application/vnd.in-toto+json";

/// A payload with its signatures, as it is kept in a file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "camelCase", deny_unknown_fields)]
pub struct Envelope {
    /// The payload in base64.
    payload: String,
    /// Its media type.
    payload_type: String,
    signatures: Vec<Signature>,
}

#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Signature {
    /// Name of the key. It is not trusted.
    #[serde(default)]
    keyid: String,
    /// The signature in base64.
    sig: String,
}

/// An envelope that is not to be trusted.
#[derive(Debug, thiserror::Error)]
pub enum EnvelopeError {
    /// The bytes are not an envelope.
    #[error("not a signed envelope (DSSE): {0}")]
    Malformed(#[from] serde_json::Error),
    /// The payload is not base64.
    #[error("the payload of the envelope is not base64")]
    NotBase64,
    /// The payload is of another type.
    #[error("the payload of the envelope is of type `{found}`, not `{PAYLOAD_TYPE}`")]
    PayloadType {
        /// The type.
        found: String,
    },
    /// No signature is of the key.
    #[error("its signature does not match its content, so one of them was altered")]
    NotSigned,
}

impl Envelope {
    /// Signs a statement.
    pub fn sign(payload: &[u8], key: &SigningKey) -> Self {
        let signature = key.sign(&pre_authentication_encoding(PAYLOAD_TYPE, payload));
        Self {
            payload: STANDARD.encode(payload),
            payload_type: PAYLOAD_TYPE.to_owned(),
            signatures: vec![Signature {
                keyid: key.public().id().to_string(),
                sig: STANDARD.encode(signature),
            }],
        }
    }

    /// Returns the envelope as a line of JSON.
    pub fn encode(&self) -> Vec<u8> {
        // Strings always serialise.
        let mut bytes = serde_json::to_vec(self).unwrap_or_default();
        bytes.push(b'\n');
        bytes
    }

    /// Reads an envelope and trusts nothing in it.
    ///
    /// # Errors
    /// Bytes that are none.
    pub fn decode(bytes: &[u8]) -> Result<Self, EnvelopeError> {
        Ok(serde_json::from_slice(bytes)?)
    }

    /// Returns the payload, whoever signed it.
    ///
    /// # Errors
    /// A payload that is not base64, or not an in-toto statement by its type.
    pub fn payload(&self) -> Result<Vec<u8>, EnvelopeError> {
        if self.payload_type != PAYLOAD_TYPE {
            return Err(EnvelopeError::PayloadType {
                found: self.payload_type.clone(),
            });
        }
        STANDARD
            .decode(&self.payload)
            .map_err(|_| EnvelopeError::NotBase64)
    }

    /// Returns true if a signature names this key. The name is not trusted.
    pub fn names(&self, key: &PublicKey) -> bool {
        let id = key.id().to_string();
        self.signatures.iter().any(|signature| signature.keyid == id)
    }

    /// Returns the payload if the key has signed it.
    ///
    /// # Errors
    /// A payload of another type, or without a signature of this key.
    pub fn verify(&self, key: &PublicKey) -> Result<Vec<u8>, EnvelopeError> {
        let payload = self.payload()?;
        let message = pre_authentication_encoding(&self.payload_type, &payload);
        let is_of_key = |signature: &Signature| {
            let decoded = STANDARD.decode(&signature.sig);
            decoded.is_ok_and(|decoded| key.verifies(&message, &decoded))
        };
        if self.signatures.iter().any(is_of_key) {
            return Ok(payload);
        }
        Err(EnvelopeError::NotSigned)
    }
}

/// Returns the bytes that are signed (DSSE, protocol, "PAE"): type and payload, each with its length before it.
fn pre_authentication_encoding(payload_type: &str, payload: &[u8]) -> Vec<u8> {
    let head = format!("DSSEv1 {} {payload_type} {} ", payload_type.len(), payload.len());
    [head.as_bytes(), payload].concat()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Test 1 of RFC 8032, section 7.1, in PKCS#8.
    const PRIVATE_PEM: &str = "-----BEGIN PRIVATE KEY-----\n\
        MC4CAQAwBQYDK2VwBCIEIJ1hsZ3v/VpguoRK9JLsLMREScVpezJpGXA7rAMcrn9g\n\
        -----END PRIVATE KEY-----\n";

    fn key() -> SigningKey {
        SigningKey::from_pem(PRIVATE_PEM).unwrap()
    }

    /// The value of the specification, protocol.md, "Test vectors".
    #[test]
    fn what_is_signed_is_what_the_specification_says() {
        let bytes = pre_authentication_encoding("http://example.com/HelloWorld", b"hello world");
        assert_eq!(bytes, b"DSSEv1 29 http://example.com/HelloWorld 11 hello world");
    }

    #[test]
    fn a_signed_payload_comes_back_and_any_other_does_not() {
        let envelope = Envelope::sign(b"{}", &key());
        let public = key().public();
        let read = Envelope::decode(&envelope.encode()).unwrap();
        assert_eq!(read.verify(&public).unwrap(), b"{}");
        for (payload, payload_type, signatures) in [
            ("e30K", PAYLOAD_TYPE, envelope.signatures.clone()),
            ("e30=", "text/plain", envelope.signatures.clone()),
            ("e30=", PAYLOAD_TYPE, Vec::new()),
            ("?", PAYLOAD_TYPE, envelope.signatures.clone()),
        ] {
            let altered = Envelope {
                payload: payload.to_owned(),
                payload_type: payload_type.to_owned(),
                signatures,
            };
            assert!(altered.verify(&public).is_err(), "{payload} {payload_type}");
        }
        assert!(Envelope::decode(b"[]").is_err());
    }

    /// The name of a key gives no trust, and its absence takes none.
    #[test]
    fn the_name_of_the_key_is_not_looked_at() {
        let mut envelope = Envelope::sign(b"{}", &key());
        envelope.signatures[0].keyid = "another".to_owned();
        assert!(envelope.verify(&key().public()).is_ok());
    }
}
