use posed_core::views::Scale;

use crate::scene::Scene;

fn measured(test: u64, problem: u64, factor: f64, views: usize) -> Option<Scale> {
    let mut scene = Scene::new(test, problem);
    let seen: Vec<_> = (0..views)
        .map(|_| {
            let camera = scene.around();
            scene.see(&camera, 1.0)
        })
        .collect();
    // What is seen is `factor` times as large as the points say.
    scene.points.iter_mut().for_each(|point| *point /= factor);
    let mut seen = seen;
    for one in &mut seen {
        one.modes = scene.solve_reading(one);
    }
    scene.solve(&seen).scale
}

#[test]
fn the_scale_is_found_and_its_sigma_is_true() {
    for (factor, is_off) in [(1.0, false), (1.02, true), (0.97, true)] {
        let found: Vec<_> = (0..600).filter_map(|problem| measured(60, problem, factor, 4)).collect();
        assert!(found.len() > 590);
        let normalised: Vec<_> = found.iter().map(|scale| (scale.value - factor) / scale.sigma).collect();
        let mean = normalised.iter().sum::<f64>() / normalised.len() as f64;
        let square = normalised.iter().map(|value| value * value).sum::<f64>() / normalised.len() as f64;
        println!("{factor}: mean {mean:.2}, mean square {square:.2} sigmas");
        // One step from 1 does not go quite all the way, and points of another size leave residuals, which widen sigma.
        assert!(
            mean.abs() < 0.5 && (if is_off { 0.6 } else { 0.85 }..1.2).contains(&square),
            "{factor}: {mean} {square}"
        );
        let off = found.iter().filter(|scale| scale.sigmas_from(1.0) > 3.0).count() as f64 / found.len() as f64;
        assert!(if is_off { off > 0.9 } else { off < 0.02 }, "{factor}: {off}");
    }
}

#[test]
fn two_views_say_nothing_of_the_scale() {
    assert_eq!(measured(61, 1, 1.02, 2), None);
}
