//! Whether a track stays with its object.

use posed_core::geometry::{Pose, Symmetries};
use posed_core::nalgebra::{Rotation3, Vector3, Vector6};
use posed_core::tracking::{MAX_TRACKS, Measurement, Options, Shape, TrackState, Tracker};
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand::rngs::SmallRng;
use rand::seq::SliceRandom as _;

use crate::simulation::{FRAME_S, Stream, at, covariance, half_turn, measured, moved, saw};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Several of one class, each on its way, told in any order, each now and then not seen.
    #[test]
    fn ids_stay_with_their_objects(seed in any::<u64>(), count in 2..5_usize, speed in 0.0..0.4_f64) {
        let mut random = SmallRng::seed_from_u64(seed);
        let mut stream = Stream::new(Options::default());
        let mut truths: Vec<Pose> = (0..count).map(|k| at(0.15 * k as f64)).collect();
        let mut ids = vec![None; count];
        for frame in 0..90_usize {
            for (k, truth) in truths.iter_mut().enumerate() {
                // Side by side back and forth, so that places are taken by one after another.
                let direction = (frame as f64 / 15.0 + k as f64 * 0.1).cos();
                *truth = moved(truth, &(Vector6::new(speed * direction, 0.0, 0.0, 0.0, speed, 0.0) * FRAME_S));
            }
            let mut told: Vec<usize> = (0..count).filter(|k| (frame + 7 * k) % 11 != 0 || frame < 5).collect();
            told.shuffle(&mut random);
            let said: Vec<_> = told.iter().map(|k| saw(measured(&truths[*k], &covariance(), &mut random))).collect();
            let views = stream.frame(&said);
            prop_assert_eq!(views.len(), count);
            for view in views {
                let Some(measurement) = view.measurement else { continue };
                let id = ids[told[measurement]].get_or_insert(view.id);
                prop_assert_eq!(*id, view.id);
            }
        }
    }

    /// Any of the poses that look alike is taken as the one that the track has.
    #[test]
    fn symmetric_answers_are_one_pose(flips in prop::collection::vec(any::<bool>(), 30)) {
        let shape = Shape { symmetries: Symmetries::new(&[half_turn()], Vec::new()).unwrap(), diameter_m: 0.1 };
        let mut tracker = Tracker::new(Options::default(), vec![shape]).unwrap();
        for (frame, flip) in flips.iter().enumerate() {
            let pose = if *flip && frame > 0 { at(0.0) * half_turn() } else { at(0.0) };
            let views = tracker.update(frame as f64 * FRAME_S, &[saw(pose)]).unwrap();
            prop_assert_eq!((views.len(), views[0].id, views[0].jumped), (1, 1, false));
            prop_assert!(views[0].world_from_object.angle_to(&at(0.0)) < 1e-6);
        }
    }
}

/// Half a turn that no symmetry allows.
fn flipped() -> Pose {
    at(0.0) * Pose::new(Rotation3::new(Vector3::z() * 3.0), Vector3::zeros())
}

#[test]
fn an_occluded_object_coasts_is_lost_and_is_found_again() {
    let mut stream = Stream::new(Options::default());
    assert_eq!(stream.frame(&[saw(at(0.0))])[0].state, TrackState::New);
    assert_eq!(stream.seen_for(20, at(0.0))[0].state, TrackState::Tracked);
    let states: Vec<_> = (0..20).map(|_| stream.frame(&[])[0].state).collect();
    let coasting = states.iter().take_while(|state| **state == TrackState::Coasting).count();
    assert_eq!(coasting, 15);
    assert!(states[coasting..].iter().all(|state| *state == TrackState::Lost));
    let again = stream.frame(&[saw(at(0.004))]);
    assert_eq!((again.len(), again[0].id, again[0].state), (1, 1, TrackState::Tracked));
    assert!(again[0].unseen_s == 0.0 && again[0].age_s > 1.0);
}

#[test]
fn what_is_found_elsewhere_is_another() {
    let mut stream = Stream::new(Options::default());
    stream.seen_for(20, at(0.0));
    (0..20).for_each(|_| drop(stream.frame(&[])));
    let mut views = stream.frame(&[saw(at(0.2))]);
    views.sort_by_key(|view| view.id);
    assert_eq!([views[0].state, views[1].state], [TrackState::Lost, TrackState::New]);
    assert_eq!([views[0].id, views[1].id], [1, 2]);
    // Turned over, it has moved, too.
    let ids: Vec<_> = stream.frame(&[saw(flipped()), saw(at(0.2))]).iter().map(|view| view.id).collect();
    assert_eq!(ids, [1, 2, 3]);
}

#[test]
fn a_lost_track_is_forgotten_in_time() {
    let mut stream = Stream::new(Options { forget_s: 1.0, ..Options::default() });
    stream.seen_for(20, at(0.0));
    let lengths: Vec<_> = (0..45).map(|_| stream.frame(&[]).len()).collect();
    assert_eq!(lengths.iter().filter(|length| **length == 1).count(), 30);
    assert_eq!(stream.frame(&[saw(at(0.0))])[0].id, 2);
}

#[test]
fn what_is_seen_once_goes_without_a_word() {
    let mut stream = Stream::new(Options::default());
    stream.frame(&[saw(at(0.0))]);
    let states: Vec<_> = (0..20).flat_map(|_| stream.frame(&[])).map(|view| view.state).collect();
    assert!(!states.contains(&TrackState::Lost), "{states:?}");
}

#[test]
fn a_jump_is_told_and_not_taken() {
    let mut stream = Stream::new(Options::default());
    stream.seen_for(30, at(0.0));
    for _ in 0..3 {
        let view = stream.frame(&[saw(flipped())]).swap_remove(0);
        assert!(view.jumped && view.measurement.is_none());
        assert!(view.world_from_object.angle_to(&at(0.0)) < 0.05);
    }
    let back = stream.frame(&[saw(at(0.0))]).swap_remove(0);
    assert_eq!((back.id, back.jumped, back.state), (1, false, TrackState::Tracked));
}

/// A track that began with the wrong answer is not kept from the right one for ever.
#[test]
fn jumps_that_agree_convince() {
    let mut stream = Stream::new(Options::default());
    stream.seen_for(3, flipped());
    let views: Vec<_> = (0..6).map(|_| stream.frame(&[saw(at(0.0))]).swap_remove(0)).collect();
    assert!(views.iter().all(|view| view.id == 1));
    assert_eq!(views.iter().filter(|view| view.jumped && view.measurement.is_none()).count(), 4);
    assert!(views[5].world_from_object.angle_to(&at(0.0)) < 1e-6);
}

/// Jumps to all sides convince nobody.
#[test]
fn jumps_that_disagree_do_not() {
    let mut stream = Stream::new(Options::default());
    stream.seen_for(30, at(0.0));
    for frame in 0..9 {
        let turn = Pose::new(Rotation3::new(Vector3::z() * (1.5 + f64::from(frame % 2) * 1.5)), Vector3::zeros());
        let view = stream.frame(&[saw(at(0.0) * turn)]).swap_remove(0);
        assert!(view.jumped && view.measurement.is_none(), "frame {frame}");
    }
}

#[test]
fn an_alternative_that_fits_is_taken_instead() {
    let mut stream = Stream::new(Options::default());
    stream.seen_for(30, at(0.0));
    let alternatives = [at(0.0)];
    let said = Measurement { alternatives: &alternatives, ..saw(flipped()) };
    let view = stream.frame(&[said]).swap_remove(0);
    assert_eq!((view.measurement, view.jumped), (Some(0), false));
}

/// The crop of a hidden object shows another one beside it: that one is not two.
#[test]
fn a_neighbour_is_not_taken_for_a_hidden_object() {
    let mut stream = Stream::new(Options::default());
    for _ in 0..30 {
        stream.frame(&[saw(at(0.0)), saw(at(0.12))]);
    }
    for _ in 0..12 {
        let hidden = Measurement { expected: Some(1), ..saw(at(0.12)) };
        let seen = Measurement { expected: Some(2), ..saw(at(0.12)) };
        let views = stream.frame(&[hidden, seen]);
        let states: Vec<_> = views.iter().map(|view| (view.id, view.state)).collect();
        assert_eq!(states, [(1, TrackState::Coasting), (2, TrackState::Tracked)]);
        assert!((views[0].world_from_object.translation().x - 0.0).abs() < 0.01);
    }
}

/// The detector sees a tracked object a second time: no second track.
#[test]
fn one_thing_is_one_track() {
    let mut stream = Stream::new(Options::default());
    stream.seen_for(10, at(0.0));
    let found = Measurement { expected: Some(1), ..saw(at(0.0)) };
    assert_eq!(stream.frame(&[found, saw(at(0.003))]).len(), 1);
}

#[test]
fn tracks_are_bounded() {
    let mut stream = Stream::new(Options::default());
    let many: Vec<_> = (0..40).map(|k| saw(at(0.2 * f64::from(k)))).collect();
    for _ in 0..5 {
        assert_eq!(stream.frame(&many).len(), MAX_TRACKS);
    }
}

/// Only a look at the whole image finds what is not tracked.
#[test]
fn the_detector_is_asked_for_when_something_is_amiss() {
    let mut stream = Stream::new(Options::default());
    assert!(stream.tracker.needs_detection());
    stream.seen_for(5, at(0.0));
    assert!(!stream.tracker.needs_detection());
    let asked: Vec<_> = (0..20).map(|_| (drop(stream.frame(&[])), stream.tracker.needs_detection()).1).collect();
    assert!(asked[0] && !asked[1] && !asked[14] && asked[15] && asked[19]);
}
