//! Real roots of a quartic, by Ferrari's method.

/// Real roots of `a4 x⁴ + a3 x³ + a2 x² + a1 x + a0`, and how many there are.
///
/// A pair of complex roots that noise has just pushed off the real axis is returned as its real part: callers polish
/// and check what they get.
pub(super) fn real_roots([a4, a3, a2, a1, a0]: [f64; 5]) -> ([f64; 4], usize) {
    let mut roots = Roots::default();
    let largest = a3.abs().max(a2.abs()).max(a1.abs()).max(a0.abs());
    if a4.abs() > 1e-12 * largest {
        let [b, c, d, e] = [a3 / a4, a2 / a4, a1 / a4, a0 / a4];
        // x = y - b / 4 removes the cubic term: y⁴ + p y² + q y + r.
        let b2 = b * b;
        let p = c - 0.375 * b2;
        let q = d - 0.5 * b * c + 0.125 * b * b2;
        let r = e - 0.25 * b * d + b2 * c / 16.0 - 3.0 * b2 * b2 / 256.0;
        depressed(p, q, r, -0.25 * b, &mut roots);
    }
    (roots.values, roots.len)
}

#[derive(Default)]
struct Roots {
    values: [f64; 4],
    len: usize,
}

impl Roots {
    fn push(&mut self, root: f64) {
        if root.is_finite() && self.len < 4 {
            self.values[self.len] = root;
            self.len += 1;
        }
    }

    /// Roots of `y² + linear y + constant`, shifted.
    fn push_quadratic(&mut self, linear: f64, constant: f64, shift: f64) {
        let discriminant = 0.25 * linear * linear - constant;
        let scale = 0.25 * linear * linear + constant.abs();
        if discriminant > 0.0 {
            let root = discriminant.sqrt();
            self.push(-0.5 * linear + root + shift);
            self.push(-0.5 * linear - root + shift);
        } else if discriminant > -1e-2 * scale {
            self.push(-0.5 * linear + shift);
        }
    }
}

fn depressed(p: f64, q: f64, r: f64, shift: f64, roots: &mut Roots) {
    // (y² + α y + β)(y² - α y + γ) with α² = z, a root of the resolvent cubic.
    let z = largest_root_of_cubic(2.0 * p, p * p - 4.0 * r, -q * q);
    let scale = p.abs().max(r.abs().sqrt());
    if z > 1e-12 * scale {
        let alpha = z.sqrt();
        roots.push_quadratic(alpha, 0.5 * (p + z - q / alpha), shift);
        roots.push_quadratic(-alpha, 0.5 * (p + z + q / alpha), shift);
        return;
    }
    // Biquadratic: y² = (-p ± sqrt(p² - 4 r)) / 2.
    let discriminant = (p * p - 4.0 * r).max(0.0).sqrt();
    for square in [0.5 * (-p + discriminant), 0.5 * (-p - discriminant)] {
        if square >= 0.0 {
            roots.push(square.sqrt() + shift);
            roots.push(-square.sqrt() + shift);
        }
    }
}

/// The largest real root of `z³ + a z² + b z + c`.
fn largest_root_of_cubic(a: f64, b: f64, c: f64) -> f64 {
    let third = a / 3.0;
    let p = b / 3.0 - third * third;
    let q = third * third * third - 0.5 * third * b + 0.5 * c;
    let discriminant = p * p * p + q * q;
    let mut root = if discriminant >= 0.0 {
        let outer = -(q.signum()) * (q.abs() + discriminant.sqrt()).cbrt();
        let inner = if outer == 0.0 { 0.0 } else { -p / outer };
        outer + inner - third
    } else {
        let angle = (-q / (-p * p * p).sqrt()).clamp(-1.0, 1.0).acos();
        2.0 * (-p).sqrt() * (angle / 3.0).cos() - third
    };
    // Two Newton steps: cancellation costs digits when the roots differ much in size.
    for _ in 0..2 {
        let slope = (3.0 * root + 2.0 * a) * root + b;
        if slope.abs() > f64::EPSILON {
            root -= (((root + a) * root + b) * root + c) / slope;
        }
    }
    root
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn expand(roots: [f64; 4]) -> [f64; 5] {
        let mut polynomial = [1.0, 0.0, 0.0, 0.0, 0.0];
        for (degree, root) in roots.into_iter().enumerate() {
            for k in (0..=degree).rev() {
                polynomial[k + 1] -= root * polynomial[k];
            }
        }
        polynomial
    }

    proptest! {
        #[test]
        fn finds_separate_real_roots(first in -3.0..3.0f64, gaps in prop::array::uniform3(0.05..2.0f64), scale in 0.1..10.0f64) {
            let wanted = [first, first + gaps[0], first + gaps[0] + gaps[1], first + gaps.iter().sum::<f64>()];
            let (mut found, count) = real_roots(expand(wanted).map(|c| c * scale));
            prop_assert_eq!(count, 4);
            found.sort_by(f64::total_cmp);
            for (root, expected) in found.iter().zip(wanted) {
                prop_assert!((root - expected).abs() < 1e-5, "{found:?} {wanted:?}");
            }
        }
    }

    #[test]
    fn no_real_roots_far_from_the_axis() {
        assert_eq!(real_roots([1.0, 0.0, 2.0, 0.0, 5.0]).1, 0);
    }
}
