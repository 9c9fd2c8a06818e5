//! Stereo pairs in the metrics of `calibrate`.

use serde::{Deserialize, Serialize};

/// A stereo pair: how its relative pose by the labels differs from that by the photos.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct StereoPair {
    /// Ids of its photos.
    pub photos: [String; 2],
    /// Angle between the relative attitudes, degrees.
    pub angle_deg: f64,
    /// Distance between the ends of the baselines, metres.
    pub distance_m: f64,
    /// What the photos say about it.
    pub verdict: Verdict,
}

/// What the photos say about the relative pose of a stereo pair by its labels.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Verdict {
    /// They agree: the cameras keep it.
    Rigid,
    /// They do not: the cameras ignore it.
    Differs,
    /// They do not determine it: the cameras keep it as well as labels are known.
    Unclear,
}

/// Returns how many stereo pairs there are and what the photos say about them. `None` without pairs.
#[must_use]
pub fn words(pairs: &[StereoPair]) -> Option<String> {
    let of = |verdict: Verdict| pairs.iter().filter(move |pair| pair.verdict == verdict);
    let largest = |value: fn(&StereoPair) -> f64| of(Verdict::Rigid).map(value).fold(0.0, f64::max);
    let (rigid, differ, unclear) = (
        of(Verdict::Rigid).count(),
        of(Verdict::Differs).count(),
        of(Verdict::Unclear).count(),
    );
    let mut parts = Vec::new();
    if rigid > 0 {
        let (angle_deg, distance_mm) = (
            largest(|pair| pair.angle_deg),
            1e3 * largest(|pair| pair.distance_m),
        );
        parts.push(format!(
            "{rigid} rigid within {angle_deg:.2} degrees and {distance_mm:.1} mm"
        ));
    }
    if differ > 0 {
        parts.push(format!("{differ} contradicted by the photos and ignored"));
    }
    if unclear > 0 {
        parts.push(format!("{unclear} unclear"));
    }
    (!parts.is_empty()).then(|| parts.join(", "))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_words_name_what_the_photos_say_of_the_pairs() {
        let pair = |verdict: Verdict, distance_m: f64| StereoPair {
            photos: ["l", "r"].map(str::to_owned),
            angle_deg: 0.02,
            distance_m,
            verdict,
        };
        assert_eq!(words(&[]), None);
        let pairs = [
            pair(Verdict::Rigid, 0.0001),
            pair(Verdict::Rigid, 0.0004),
            pair(Verdict::Differs, 0.05),
            pair(Verdict::Unclear, 0.01),
        ];
        assert_eq!(
            words(&pairs).unwrap(),
            "2 rigid within 0.02 degrees and 0.4 mm, 1 contradicted by the photos and ignored, 1 unclear"
        );
        assert_eq!(words(&pairs[3..]).unwrap(), "1 unclear");
    }
}
