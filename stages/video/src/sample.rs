use crate::yuv::Yuv;

/// A picture as the file holds it.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub(crate) struct Sample {
    pub bytes: Vec<u8>,
    /// Whether decoding can begin here.
    pub is_key: bool,
    /// The box that a decoder needs before the first picture, if the codec gives it with this sample.
    pub config: Option<Vec<u8>>,
}

/// A codec: pictures of one size to samples, one for one and in order.
pub(crate) trait Coder {
    /// Encodes the next picture. Its sample may come with a later one.
    ///
    /// # Errors
    /// An error of the encoder.
    fn encode(&mut self, picture: &Yuv) -> Result<Vec<Sample>, String>;

    /// Returns the samples that have not come yet.
    ///
    /// # Errors
    /// An error of the encoder.
    fn finish(&mut self) -> Result<Vec<Sample>, String> {
        Ok(Vec::new())
    }
}
