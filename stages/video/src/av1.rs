//! AV1 by rav1e at a constant quantiser.

use rav1e::prelude::{
    ColorDescription, ColorPrimaries, Config, Context, EncoderConfig, EncoderStatus, FrameType,
    MatrixCoefficients, Packet, PixelRange, Rational, SceneDetectionSpeed, TransferCharacteristics, Tune,
};

use crate::{
    KEY_EVERY, Settings,
    mp4::boxed,
    sample::{Coder, Sample},
    yuv::Yuv,
};

/// The fastest preset: the one before takes 1.6 times as long for 8 % fewer bytes, number 6 takes 3.6 times as long for 27 %
/// (benches/video.md).
const SPEED: u8 = 10;

/// Index of AV1's quantisers for every QP of H.264 from 12: the one whose step is nearest to 8 x 0.625 x
/// 2^(QP/6), as AV1's transforms are scaled by 8 (AV1 specification, section 7.12.2, `Ac_Qlookup` of 8 bits).
const INDEX: [u8; 40] = [
    13, 15, 18, 21, 25, 29, 33, 38, 43, 50, 56, 64, 73, 83, 94, 101, 107, 115, 123, 129, 137, 143, 150, 156,
    162, 169, 175, 182, 188, 194, 200, 206, 212, 218, 224, 231, 237, 242, 249, 254,
];

/// An encoder of one video.
pub(crate) struct Av1 {
    context: Context<u8>,
    /// The `av1C` without the sequence header.
    record: Vec<u8>,
}

impl Av1 {
    /// Opens an encoder for checked settings and even sides of 16 and more.
    ///
    /// # Errors
    /// An error of rav1e.
    pub fn new(settings: &Settings, width: u32, height: u32) -> Result<Self, String> {
        // Built without threads: the number is that of a pool that is never asked for.
        let config = Config::new().with_encoder_config(config(settings, width, height));
        let context: Context<u8> = config.new_context().map_err(|error| error.to_string())?;
        Ok(Self {
            record: context.container_sequence_header(),
            context,
        })
    }

    /// Returns the samples that are ready.
    fn ready(&mut self) -> Result<Vec<Sample>, String> {
        let mut samples = Vec::new();
        loop {
            match self.context.receive_packet() {
                Ok(packet) => samples.push(sample(&self.record, &packet)?),
                Err(EncoderStatus::Encoded) => {}
                Err(EncoderStatus::NeedMoreData | EncoderStatus::LimitReached) => return Ok(samples),
                Err(error) => return Err(error.to_string()),
            }
        }
    }
}

impl Coder for Av1 {
    fn encode(&mut self, picture: &Yuv) -> Result<Vec<Sample>, String> {
        let mut frame = self.context.new_frame();
        let planes = [
            (&picture.y, picture.width),
            (&picture.cb, picture.width / 2),
            (&picture.cr, picture.width / 2),
        ];
        for (plane, (bytes, stride)) in frame.planes.iter_mut().zip(planes) {
            plane.copy_from_raw_u8(bytes, stride, 1);
        }
        let sent = self.context.send_frame(frame);
        sent.map_err(|error| error.to_string())?;
        self.ready()
    }

    fn finish(&mut self) -> Result<Vec<Sample>, String> {
        self.context.flush();
        self.ready()
    }
}

/// Returns the configuration: nothing adapts to content or to a rate, and pictures are encoded in their order.
///
/// Reordering them saves a tenth of the bytes and takes half as long again. Weighing blocks by visibility
/// costs a third more time and gains nothing in PSNR (benches/video.md).
fn config(settings: &Settings, width: u32, height: u32) -> EncoderConfig {
    let mut config = EncoderConfig::with_speed_preset(SPEED);
    (config.width, config.height) = (width as usize, height as usize);
    config.time_base = Rational::new(1, u64::from(settings.frames_per_second));
    config.quantizer = usize::from(index(settings.quantizer));
    config.low_latency = true;
    config.tune = Tune::Psnr;
    config.set_key_frame_interval(u64::from(KEY_EVERY), u64::from(KEY_EVERY));
    config.speed_settings.scene_detection_mode = SceneDetectionSpeed::None;
    config.pixel_range = PixelRange::Limited;
    config.color_description = Some(ColorDescription {
        color_primaries: ColorPrimaries::BT709,
        transfer_characteristics: TransferCharacteristics::BT709,
        matrix_coefficients: MatrixCoefficients::BT709,
    });
    config
}

/// Returns the index of AV1 for a quantiser in [`crate::QUANTIZERS`].
fn index(quantizer: u32) -> u8 {
    let at = quantizer.saturating_sub(*crate::QUANTIZERS.start()) as usize;
    INDEX[at.min(INDEX.len() - 1)]
}

/// Types of units (AV1 specification, section 6.2.2).
const SEQUENCE_HEADER: u8 = 1;
const TEMPORAL_DELIMITER: u8 = 2;

/// Returns a packet as the file holds it, without the temporal delimiter ("AV1 Codec ISO Media File Format
/// Binding", section 2.4). A packet with a sequence header also gives the `av1C` (section 2.3).
fn sample(record: &[u8], packet: &Packet<u8>) -> Result<Sample, String> {
    let mut sample = Sample {
        is_key: packet.frame_type == FrameType::KEY,
        ..Sample::default()
    };
    let mut rest = packet.data.as_slice();
    while !rest.is_empty() {
        let length = unit_length(rest).filter(|length| *length <= rest.len());
        let (unit, behind) = rest.split_at(length.ok_or("a unit of its stream has no length")?);
        match (unit[0] >> 3) & 0xf {
            TEMPORAL_DELIMITER => {}
            kind => {
                if kind == SEQUENCE_HEADER {
                    sample.config = Some(boxed(b"av1C", &[record, unit]));
                }
                sample.bytes.extend(unit);
            }
        }
        rest = behind;
    }
    Ok(sample)
}

/// Returns the bytes of the first unit of a stream, header included. `None` if it does not state its size
/// (sections 5.3.2, 4.10.5).
fn unit_length(stream: &[u8]) -> Option<usize> {
    let header = *stream.first()?;
    let has_extension = header & 4 != 0;
    if header & 2 == 0 {
        return None;
    }
    let start = if has_extension { 2 } else { 1 };
    let (mut length, mut at) = (0_usize, start);
    loop {
        let byte = *stream.get(at)?;
        let shift = 7 * (at - start);
        if shift > 21 {
            return None; // a picture has less than 2^28 bytes
        }
        length |= usize::from(byte & 0x7f) << shift;
        at += 1;
        if byte & 0x80 == 0 {
            return Some(at + length);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_unit_ends_where_its_length_says() {
        for (stream, length) in [
            (&[0x12, 0][..], Some(2)),
            (&[0x0a, 3, 7, 7, 7, 9], Some(5)),
            (&[0x36, 0, 2, 7, 7], Some(5)),
            (&[0x32, 0x81, 1], Some(3 + 129)),
            (&[0x32, 0x80, 0x80, 0x80, 0x80, 1], None),
            (&[0x10, 0], None),
            (&[0x32], None),
            (&[0x32, 0x80], None),
            (&[], None),
        ] {
            assert_eq!(unit_length(stream), length, "{stream:x?}");
        }
    }

    /// QP 12 has step 2.5, 20 of AV1's units. QP 51 has 226, 1810 of them.
    #[test]
    fn quantisers_get_coarser_by_one_at_least() {
        let indices: Vec<u8> = crate::QUANTIZERS.map(index).collect();
        assert!(indices.windows(2).all(|pair| pair[0] < pair[1]), "{indices:?}");
        assert_eq!((indices[0], indices[39], indices.len()), (13, 254, 40));
    }
}
