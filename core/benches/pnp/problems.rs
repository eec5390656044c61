//! Solves a file of problems and times every solve.

use std::fs;
use std::path::Path;
use std::time::Instant;

use nalgebra::{Matrix2, Vector2, Vector3};
use posed_core::geometry::Camera;
use posed_core::pnp::{Options, Solution, Status, solve};
use serde::{Deserialize, Serialize};

/// Solves of each problem; the fastest counts, since other programs share the machine.
const REPEATS: usize = 5;

#[derive(Deserialize)]
struct Problem {
    points_m: Vec<[f64; 3]>,
    pixels: Vec<[f64; 2]>,
    covariances_px2: Vec<[[f64; 2]; 2]>,
}

#[derive(Deserialize)]
struct File {
    camera: Camera,
    problems: Vec<Problem>,
}

#[derive(Serialize)]
struct Answer {
    /// `camera_from_points`, row-major; absent when there is no pose.
    matrix: Option<[[f64; 4]; 4]>,
    ok: bool,
    microseconds: f64,
}

/// Reads a problem file and writes `<path>.answers`.
pub(crate) fn solve_file(path: &Path) {
    let text = fs::read_to_string(path).expect("the problem file");
    let file: File = serde_json::from_str(&text).expect("a problem file");
    let answers: Vec<Answer> = file.problems.iter().map(|problem| answer(problem, &file.camera)).collect();
    let json = serde_json::to_string(&answers).expect("answers as JSON");
    fs::write(path.with_extension("answers"), json).expect("the answer file");
}

fn answer(problem: &Problem, camera: &Camera) -> Answer {
    let points: Vec<_> = problem.points_m.iter().map(|p| Vector3::from(*p)).collect();
    let pixels: Vec<_> = problem.pixels.iter().map(|p| Vector2::from(*p)).collect();
    let covariances: Vec<_> =
        problem.covariances_px2.iter().map(|[a, b]| Matrix2::new(a[0], a[1], b[0], b[1])).collect();
    let options = Options { floor_px: 0.0, ..Options::default() };
    let mut fastest = f64::INFINITY;
    let mut solution = None;
    for _ in 0..REPEATS {
        let start = Instant::now();
        solution = solve(&points, &pixels, &covariances, camera, &options).ok();
        fastest = fastest.min(start.elapsed().as_secs_f64());
    }
    Answer {
        matrix: solution.as_ref().map(|s: &Solution| s.pose.matrix().transpose().into()),
        ok: solution.is_some_and(|s| s.status == Status::Ok),
        microseconds: 1e6 * fastest,
    }
}
