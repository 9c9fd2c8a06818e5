/// A picture as the file holds it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Sample {
    pub bytes: Vec<u8>,
    /// Whether decoding can begin here.
    pub is_key: bool,
    /// The box that a decoder needs before the first picture, if the encoder gives it with this sample.
    pub config: Option<Vec<u8>>,
}
