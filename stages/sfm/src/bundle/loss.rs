//! Robust losses.

/// Loss ρ of a squared residual s. The cost is ½ Σ ρ(s).
///
/// The width is in the unit of the residual: pixels for observations, sigmas for priors.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Loss {
    /// s.
    Squared,
    /// s up to width², then 2 width √s - width².
    Huber(f64),
    /// width² ln(1 + s / width²).
    Cauchy(f64),
}

impl Loss {
    /// Returns ρ(s).
    pub(super) fn cost(self, squared: f64) -> f64 {
        match self {
            Self::Huber(width) if squared > width * width => width * (2.0 * squared.sqrt() - width),
            Self::Cauchy(width) => width * width * libm::log1p(squared / (width * width)),
            _ => squared,
        }
    }

    /// Returns ρ'(s), in (0, 1]: the weight with which a squared residual has the gradient of its loss.
    pub(super) fn weight(self, squared: f64) -> f64 {
        match self {
            Self::Huber(width) if squared > width * width => width / squared.sqrt(),
            Self::Cauchy(width) => 1.0 / (1.0 + squared / (width * width)),
            _ => 1.0,
        }
    }

    /// Whether the width is a finite number above 1e-12 (its square must not vanish).
    pub(super) fn is_valid(self) -> bool {
        match self {
            Self::Squared => true,
            Self::Huber(width) | Self::Cauchy(width) => (1e-12..1e12).contains(&width),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn losses_at_hand_worked_residuals() {
        assert_eq!(Loss::Squared.cost(9.0), 9.0);
        assert_eq!(Loss::Huber(1.0).cost(0.25), 0.25);
        assert_eq!(Loss::Huber(1.0).cost(9.0), 5.0);
        assert!((Loss::Cauchy(2.0).cost(4.0) - 4.0 * 2.0_f64.ln()).abs() < 1e-15);
        assert_eq!(Loss::Cauchy(2.0).weight(4.0), 0.5);
    }

    #[test]
    fn the_weight_is_the_slope_of_the_loss() {
        for loss in [Loss::Squared, Loss::Huber(1.5), Loss::Cauchy(0.7)] {
            for s in [0.01, 1.0, 2.0, 3.0, 100.0, 1e6] {
                let h = s * 1e-5;
                let slope = (loss.cost(s + h) - loss.cost(s - h)) / (2.0 * h);
                assert!((slope - loss.weight(s)).abs() < 1e-6, "{loss:?} at {s}: {slope}");
            }
        }
    }
}
