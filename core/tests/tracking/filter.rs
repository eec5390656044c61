//! Whether the filter's poses are as good as it says, and better than what it was told.

use posed_core::geometry::{Pose, sigmas};
use posed_core::nalgebra::Vector6;
use posed_core::tracking::{Options, TrackState};
use rand::SeedableRng as _;
use rand::rngs::SmallRng;

use crate::simulation::{FRAME_S, Stream, at, covariance, gaussian, independent, measured, moved, saw};

/// Mean squared error in units of the stated covariance, over many streams, after the filter has settled.
fn mean_nees(options: Options, drive: impl Fn(&mut Vector6<f64>, &mut SmallRng)) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0);
    for seed in 0..60 {
        let mut random = SmallRng::seed_from_u64(seed);
        let (mut stream, mut truth, mut velocity) = (Stream::new(options), at(0.1), Vector6::zeros());
        for frame in 0..60 {
            drive(&mut velocity, &mut random);
            truth = moved(&truth, &(velocity * FRAME_S));
            let view = stream.frame(&[saw(measured(&truth, &covariance(), &mut random))]).swap_remove(0);
            if frame >= 10 {
                let error = view.world_from_object.step_to(&truth);
                sum += error.dot(&view.covariance.cholesky().unwrap().solve(&error));
                count += 1.0;
            }
        }
    }
    sum / count
}

/// 6 is honest.
#[test]
fn a_moving_objects_covariance_is_as_large_as_its_errors() {
    let options = independent();
    let scale = [options.velocity_change_m_s, options.turn_change_rad_s].map(|change| change * FRAME_S.sqrt());
    let nees = mean_nees(options, |velocity, random| {
        let change = gaussian(random);
        *velocity += Vector6::from_fn(|k, _| change[k] * scale[k / 3]);
    });
    assert!((4.8..=7.2).contains(&nees), "{nees}");
}

#[test]
fn a_still_objects_covariance_is_as_large_as_its_errors() {
    let nees = mean_nees(independent(), |_, _| ());
    assert!((3.5..=7.2).contains(&nees), "{nees}");
}

fn spread(poses: &[Pose]) -> [f64; 2] {
    let mean = poses.iter().map(|pose| poses[0].step_to(pose)).sum::<Vector6<f64>>() / poses.len() as f64;
    let square = |first: usize| {
        let apart = |pose: &Pose| (poses[0].step_to(pose) - mean).fixed_rows::<3>(first).norm_squared();
        (poses.iter().map(apart).sum::<f64>() / poses.len() as f64).sqrt()
    };
    [square(0), square(3)]
}

#[test]
fn a_still_object_is_stiller_than_its_measurements() {
    let mut random = SmallRng::seed_from_u64(7);
    let (mut stream, truth) = (Stream::new(Options::default()), at(0.0));
    let (mut said, mut filtered) = (Vec::new(), Vec::new());
    for frame in 0..300 {
        let pose = measured(&truth, &covariance(), &mut random);
        let view = stream.frame(&[saw(pose)]).swap_remove(0);
        if frame >= 60 {
            said.push(pose);
            filtered.push(view.world_from_object);
        }
    }
    for (said, filtered) in spread(&said).into_iter().zip(spread(&filtered)) {
        assert!(filtered < 0.4 * said, "{filtered} of {said}");
    }
}

/// What starts to move after a long rest is followed at once, and comes to rest again.
#[test]
fn a_start_and_a_stop_are_followed() {
    let mut random = SmallRng::seed_from_u64(3);
    let (mut stream, mut truth, mut velocity) = (Stream::new(independent()), at(0.0), 0.0);
    for frame in 0..180 {
        // 0.3 m/s for one second.
        if (60..90).contains(&frame) {
            truth = moved(&truth, &(Vector6::new(0.3, 0.0, 0.0, 0.0, 0.0, 0.5) * FRAME_S));
        }
        let view = stream.frame(&[saw(measured(&truth, &covariance(), &mut random))]).swap_remove(0);
        let error = view.world_from_object.step_to(&truth);
        let lag_m = error.fixed_rows::<3>(0).norm();
        assert!(lag_m < 0.02, "frame {frame}: {lag_m} m off");
        assert!(frame == 0 || (view.id == 1 && !view.jumped), "frame {frame}");
        if (75..90).contains(&frame) {
            velocity += view.velocity[0] / 15.0;
        }
    }
    assert!((velocity - 0.3).abs() < 0.06, "{velocity} m/s");
    let (shift, _) = sigmas(&stream.tracker.views()[0].covariance);
    assert!(shift < 0.003);
}

/// Where frames come so fast that their errors are alike, a second of them says no more than a second of slow ones.
#[test]
fn frames_with_like_errors_do_not_make_it_surer() {
    let sigma_after = |frames_per_s: u32| {
        let options = Options { error_memory_s: 0.5, ..Options::default() };
        let mut stream = Stream::new(options);
        for frame in 1..=4 * frames_per_s {
            stream.tracker.update(f64::from(frame) / f64::from(frames_per_s), &[saw(at(0.0))]).unwrap();
        }
        sigmas(&stream.tracker.views()[0].covariance).0
    };
    let ratio = sigma_after(60) / sigma_after(6);
    assert!((0.8..1.25).contains(&ratio), "{ratio}");
}

/// A prediction is where the object will be.
#[test]
fn predictions_follow_the_motion() {
    let (mut stream, mut truth) = (Stream::new(independent()), at(0.0));
    let velocity = Vector6::new(0.2, -0.1, 0.0, 0.3, 0.0, 0.4);
    for _ in 0..60 {
        truth = moved(&truth, &(velocity * FRAME_S));
        let views = stream.frame(&[saw(truth)]);
        assert_ne!(views[0].state, TrackState::Coasting);
    }
    let ahead = stream.tracker.predictions(stream.time_s + 2.0 * FRAME_S)[0];
    let off = ahead.world_from_object.step_to(&moved(&truth, &(velocity * 2.0 * FRAME_S)));
    assert!(off.fixed_rows::<3>(0).norm() < 2e-3 && off.fixed_rows::<3>(3).norm() < 0.02, "{off}");
    assert_eq!(ahead.id, 1);
}
