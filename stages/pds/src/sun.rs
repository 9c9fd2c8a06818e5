//! The light of the sun on Mars, which turns I/F into radiance.

use nalgebra::ComplexField;

/// First wavelength of [`IRRADIANCE`], and the step between two, nm.
const FIRST_NM: f64 = 400.0;
const STEP_NM: f64 = 50.0;
/// Irradiance of the sun at 1 AU outside the atmosphere, W / (m2 nm): means over 20 nm of ASTM G173-03. Between two of
/// them the interpolation is within 4 % below 500 nm and 2 % above.
const IRRADIANCE: [f64; 15] = [
    1.347, 1.975, 1.936, 1.848, 1.765, 1.563, 1.428, 1.275, 1.134, 0.998, 0.916, 0.819, 0.741, 0.660, 0.590,
];
/// Wavelength of a broad-band filter, nm.
pub(crate) const BROAD_BAND_NM: f64 = 550.0;

/// Semi-major axis (AU) and eccentricity of the orbit of Mars, and its solar longitude at perihelion, degrees.
const AXIS_AU: f64 = 1.523_68;
const ECCENTRICITY: f64 = 0.0934;
const PERIHELION_DEG: f64 = 251.0;

/// Returns the spectral radiance of a white surface (I/F = 1) under the sun on Mars, W / (m2 sr nm).
///
/// L = F(λ) / (π r²), with the irradiance F at 1 AU and the distance r = a (1 - e²) / (1 + e cos(Ls - 251°)). Without a
/// solar longitude r is the semi-major axis.
///
/// # Extremes
/// Wavelengths outside 400 to 1100 nm count as the nearest of these. r is within 1.38 and 1.67 AU for any Ls.
pub(crate) fn white_radiance(wavelength_nm: f64, solar_longitude_deg: Option<f64>) -> f64 {
    let last = IRRADIANCE.len() - 1;
    let place = ((wavelength_nm - FIRST_NM) / STEP_NM).clamp(0.0, last as f64);
    let below = (place as usize).min(last - 1);
    let part = place - below as f64;
    let irradiance = IRRADIANCE[below] * (1.0 - part) + IRRADIANCE[below + 1] * part;
    let distance_au = solar_longitude_deg.map_or(AXIS_AU, |longitude| {
        let anomaly = (longitude - PERIHELION_DEG).to_radians();
        AXIS_AU * (1.0 - ECCENTRICITY * ECCENTRICITY) / (1.0 + ECCENTRICITY * ComplexField::cos(anomaly))
    });
    irradiance / (std::f64::consts::PI * distance_au * distance_au)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// By hand: 1.848 / (π 1.52368²) = 0.25338.
    #[test]
    fn a_white_surface_shines_as_computed_by_hand() {
        assert!((white_radiance(550.0, None) - 0.253_38).abs() < 1e-5);
        let middle = white_radiance(575.0, None) / white_radiance(550.0, None);
        assert!((middle - (1.848 + 1.765) / 2.0 / 1.848).abs() < 1e-12, "{middle}");
    }

    /// Perihelion at 1.3814 AU, aphelion at 1.6660 AU: the light differs by (1.6660 / 1.3814)² = 1.4545.
    #[test]
    fn the_light_follows_the_distance_from_the_sun() {
        let (near, far) = (
            white_radiance(550.0, Some(251.0)),
            white_radiance(550.0, Some(71.0)),
        );
        assert!((near / far - 1.4545).abs() < 1e-3, "{}", near / far);
        let mean = white_radiance(550.0, None);
        assert!(far < mean && mean < near);
    }

    #[test]
    fn wavelengths_outside_the_table_count_as_its_ends() {
        for (outside, end) in [
            (-1.0, 400.0),
            (f64::NEG_INFINITY, 400.0),
            (2000.0, 1100.0),
            (f64::INFINITY, 1100.0),
        ] {
            assert_eq!(
                white_radiance(outside, None),
                white_radiance(end, None),
                "{outside}"
            );
        }
    }
}
