//! What the stated trust makes of covariances, probabilities and statuses.

use posed::estimator::{Reason, SolvedPose, Verdict};
use posed::model::{Evidence, LoadError, Trust};
use posed_core::geometry::{Covariance6, covariance_about};
use posed_core::pnp::Status;
use serde::Deserialize;
use serde_json::{Value, json};

use crate::script::{Manifests, Models, Script, camera, image};

fn linear(constant: f64) -> Value {
    json!({"constant": constant, "weights": {}})
}

fn trust(probability: &Value) -> Value {
    json!({
        "ranges": {"outliers": [0.0, 1.0]},
        "covariance": {"depth": linear(2_f64.ln()), "lateral": linear(3_f64.ln()), "rotation": linear(1.5_f64.ln())},
        "probability": probability,
        "ok_probability": 0.9,
    })
}

fn load(trust: Option<Value>) -> Result<Models, LoadError> {
    let mut manifests = Manifests::default();
    if let Some(trust) = trust {
        manifests.object["trust"] = trust;
    }
    Models::load(&manifests, Script::default())
}

fn answer(trust: Option<Value>) -> (Verdict, f64, SolvedPose) {
    let poses = load(trust).unwrap().estimator().unwrap().estimate(&image(50), &camera()).unwrap().poses;
    let [pose] = &poses[..] else { panic!("one object, one answer") };
    (pose.verdict, pose.confidence(), pose.pose.clone().unwrap())
}

#[test]
fn covariances_are_those_of_the_solver_by_the_stated_factors() {
    let (_, _, bare) = answer(None);
    let (_, _, scaled) = answer(Some(trust(&linear(9.0))));
    let ray = bare.camera_from_object.translation().normalize();
    let along = |covariance: &Covariance6| ray.dot(&(covariance.fixed_view::<3, 3>(0, 0) * ray));
    let across = |covariance: &Covariance6| covariance.fixed_view::<3, 3>(0, 0).trace() - along(covariance);
    let turn = |covariance: &Covariance6| covariance.fixed_view::<3, 3>(3, 3).trace();
    // The keypoints' frame and the object's have one origin here.
    assert_eq!(covariance_about(&bare.image_covariance, &(ray * 0.0)), bare.image_covariance);
    for (part, factor) in [(&along as &dyn Fn(&Covariance6) -> f64, 2.0), (&across, 3.0), (&turn, 1.5_f64)] {
        let ratio = part(&scaled.image_covariance) / part(&bare.image_covariance);
        assert!((ratio / (factor * factor) - 1.0).abs() < 1e-9, "{ratio} is not {factor} squared");
    }
    // What is the offset's is not the image's, and stays.
    let offset = |solved: &SolvedPose| solved.covariance - solved.image_covariance;
    assert!((offset(&scaled) - offset(&bare)).norm() < 1e-9 * offset(&bare).norm());
    assert!(scaled.covariance.cholesky().is_some());
}

/// A dozen held-out photos tell how far poses scatter, but no probability.
#[test]
fn covariances_may_be_all_that_is_known() {
    let mut stated = trust(&linear(0.0));
    for field in ["probability", "ok_probability"] {
        stated.as_object_mut().unwrap().remove(field);
    }
    let (bare_verdict, bare_confidence, bare) = answer(None);
    let (verdict, confidence, solved) = answer(Some(stated.clone()));
    assert!(solved.image_covariance.trace() > 2.0 * bare.image_covariance.trace());
    assert_eq!((solved.probability, verdict.status), (None, bare_verdict.status));
    assert!((confidence - bare_confidence).abs() < 1e-12, "{confidence}");
    // A threshold on a probability that is not stated changes nothing.
    let demanding = load(Some(stated)).unwrap().demanding(1.0);
    let poses = demanding.estimator().unwrap().estimate(&image(50), &camera()).unwrap().poses;
    assert_eq!(poses[0].verdict.status, bare_verdict.status);
}

#[test]
fn ok_is_a_threshold_on_the_probability() {
    // The logit of 0.9 is 2.197.
    let (verdict, confidence, solved) = answer(Some(trust(&linear(2.3))));
    assert_eq!(verdict.status, Status::Ok);
    assert_eq!(Some(confidence), solved.probability);
    assert!((confidence - 0.9089).abs() < 1e-4);
    let (verdict, confidence, _) = answer(Some(trust(&linear(2.1))));
    assert_eq!(verdict.status, Status::LowConfidence);
    assert!(verdict.reasons.iter().eq([Reason::Improbable]));
    assert!((confidence - 0.8909).abs() < 1e-4);
}

#[test]
fn evidence_beyond_what_the_fit_has_seen_is_taken_for_its_end() {
    // The scripted detector is surer than any that the fit has seen.
    let at_most = |most: f64| {
        let mut stated = trust(&json!({"constant": 0.0, "weights": {"score": 1.0}}));
        stated["ranges"] = json!({"score": [0.0, most]});
        answer(Some(stated)).1
    };
    assert!((at_most(0.5) - 0.6225).abs() < 1e-4);
    assert!(at_most(1.0) > 0.66);
}

#[test]
fn trust_that_cannot_be_meant_is_refused_by_its_field() {
    let refused = |change: &dyn Fn(&mut Value), words: &[&str]| {
        let mut stated = trust(&linear(1.0));
        change(&mut stated);
        let Err(error) = load(Some(stated)) else { panic!("accepted, despite {words:?}") };
        let message = error.to_string();
        assert!(words.iter().all(|word| message.contains(word)), "{message}");
    };
    refused(&|t| t["ranges"]["mood"] = json!([0, 1]), &["trust.ranges", "mood", "crops_apart"]);
    refused(&|t| t["ranges"]["outliers"] = json!([1, 0]), &["trust.ranges", "outliers"]);
    refused(&|t| t["probability"]["weights"]["score"] = json!(1), &["trust.probability", "score", "no range"]);
    refused(&|t| t["covariance"]["depth"]["constant"] = json!(1e7), &["trust.covariance.depth"]);
    refused(&|t| t["ok_probability"] = json!(2), &["trust.ok_probability", "between 0 and 1"]);
    refused(&|t| t["probability"] = Value::Null, &["trust.probability", "missing", "ok_probability"]);
    refused(&|t| t["ok_probability"] = Value::Null, &["trust.ok_probability", "missing"]);
    refused(&|t| t["covariance"]["sideways"] = linear(0.0), &["sideways"]);
}

/// The tests of the trainer (`training/tests/test_trust.py`) read this file, too.
#[test]
fn the_trainer_and_the_service_mean_the_same() {
    #[derive(Deserialize)]
    struct Fixture {
        trust: Trust,
        views: Vec<View>,
    }
    #[derive(Deserialize)]
    struct View {
        evidence: Evidence,
        factors: [f64; 3],
        probability: f64,
    }
    let fixture: Fixture = serde_json::from_str(include_str!("../data/trust.json")).unwrap();
    assert!(fixture.views.len() > 3);
    for View { evidence, factors, probability } in fixture.views {
        for (found, expected) in fixture.trust.factors(&evidence).into_iter().zip(factors) {
            assert!((found / expected - 1.0).abs() < 1e-6, "{found} is not {expected}");
        }
        let found = fixture.trust.probability(&evidence).unwrap();
        assert!((found - probability).abs() < 1e-6, "{found} is not {probability}");
    }
}
