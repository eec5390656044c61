//! Times and options that mean nothing.

use posed_core::tracking::{Options, TimeError, Tracker};

use crate::simulation::{at, saw, shape, tracker};

#[test]
fn frames_come_in_the_order_of_their_capture() {
    let mut tracker = tracker(Options::default());
    tracker.update(-3.0, &[saw(at(0.0))]).unwrap();
    for time_s in [-3.0, -4.0, f64::NEG_INFINITY, f64::INFINITY, f64::NAN] {
        let refused = tracker.update(time_s, &[saw(at(0.5))]).unwrap_err();
        assert_eq!(matches!(refused, TimeError::NotFinite(_)), !time_s.is_finite());
    }
    // Nothing of them is left.
    let views = tracker.update(-2.9, &[saw(at(0.0))]).unwrap();
    assert_eq!((views.len(), views[0].id), (1, 1));
}

/// After a pause nothing is predicted into the blue.
#[test]
fn a_pause_is_no_catastrophe() {
    let mut tracker = tracker(Options::default());
    for frame in 0..30 {
        tracker.update(f64::from(frame) / 30.0, &[saw(at(0.001 * f64::from(frame)))]).unwrap();
    }
    let views = tracker.update(1e12, &[saw(at(0.029))]).unwrap();
    assert_eq!(views.len(), 1);
    assert!(views[0].world_from_object.matrix().iter().chain(&views[0].covariance).all(|value| value.is_finite()));
}

#[test]
fn options_have_ranges() {
    let default = Options::default();
    for (options, field) in [
        (Options { velocity_change_m_s: 0.0, ..default }, "velocity_change_m_s"),
        (Options { turn_change_rad_s: f64::NAN, ..default }, "turn_change_rad_s"),
        (Options { error_memory_s: -1.0, ..default }, "error_memory_s"),
        (Options { max_coast_s: 61.0, ..default }, "max_coast_s"),
        (Options { forget_s: f64::INFINITY, ..default }, "forget_s"),
    ] {
        let refused = Tracker::new(options, vec![shape()]).err().unwrap();
        assert_eq!(refused.field, field);
    }
}
