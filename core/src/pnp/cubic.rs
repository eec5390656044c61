/// A real root of `c3 x³ + c2 x² + c1 x + c0` with `c3` not zero: the only one, or the greatest of three.
pub(super) fn real_root([c3, c2, c1, c0]: [f64; 4]) -> f64 {
    let (a, b, c) = (c2 / c3, c1 / c3, c0 / c3);
    let third = a / 3.0;
    // x = y - a / 3 removes the square term: y³ + 3 p y + 2 q.
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
    // Newton: cancellation above costs digits when the roots differ much in size.
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

    proptest! {
        #[test]
        fn finds_the_greatest_of_three(roots in prop::array::uniform3(-10.0..10.0f64), scale in 0.1..10.0f64) {
            let [u, v, w] = roots;
            let greatest = u.max(v).max(w);
            prop_assume!(roots.iter().filter(|r| greatest - **r < 1e-3).count() == 1);
            let found = real_root([scale, -scale * (u + v + w), scale * (u * v + v * w + w * u), -scale * u * v * w]);
            prop_assert!((found - greatest).abs() < 1e-9, "{found} {roots:?}");
        }

        #[test]
        fn finds_the_only_one(root in -10.0..10.0f64, real in -10.0..10.0f64, imaginary in 0.1..10.0f64) {
            let square = real * real + imaginary * imaginary;
            let found = real_root([1.0, -root - 2.0 * real, square + 2.0 * root * real, -root * square]);
            prop_assert!((found - root).abs() < 1e-8, "{found} {root}");
        }
    }
}
