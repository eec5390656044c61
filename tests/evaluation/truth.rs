use nalgebra::Matrix6;
use posed::evaluation::{Consistency, Deviation, PoseNees, Recall, ScoredView};
use proptest::prelude::*;

use crate::objects::{any_pose, camera, can, points, symmetries};

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// The truth, or a pose that looks exactly like it, has full marks everywhere.
    #[test]
    fn the_truth_scores_full_marks(poses in prop::collection::vec(any_pose(), 1..5), element in 0..4usize, step in 0..315u32) {
        for symmetries in symmetries() {
            let points = points(&can(5, 315, symmetries.clone()));
            let mut views = Vec::new();
            let mut errors = Vec::new();
            for truth in &poses {
                let mut estimate = *truth * symmetries.discrete()[element % symmetries.discrete().len()];
                if let [axis] = symmetries.continuous() {
                    estimate = estimate * axis.turn(std::f64::consts::TAU * f64::from(step) / 315.0);
                }
                // The can is not symmetric under the discrete ones, so that ADD-S is zero only for the truth itself.
                let deviation = Deviation::new(&points, &camera(), &estimate, truth);
                prop_assert!(deviation.mssd_m < 1e-9 && deviation.mspd_px < 1e-6 && deviation.translation_m < 1e-9);
                prop_assert!(deviation.rotation_deg < 1e-6);
                let deviation = Deviation::new(&points, &camera(), truth, truth);
                views.push(ScoredView { deviation: Some(deviation), diameter_m: points.diameter_m(), image_width_px: 640 });
                errors.push(PoseNees::new(&points, &estimate, &(Matrix6::identity() * 1e-4), truth));
            }
            let recall = Recall::of(&views).unwrap();
            prop_assert_eq!((recall.views, recall.poses), (poses.len(), poses.len()));
            let shares = recall.degrees_centimetres.iter().map(|one| one.share);
            for share in shares.chain([recall.add, recall.proj5, recall.ar_mssd, recall.ar_mspd, recall.ar_without_vsd]) {
                prop_assert!((share - 1.0).abs() < 1e-12);
            }
            prop_assert!(recall.median_add_m < 1e-9 && recall.median_rotation_deg < 1e-6);
            let consistency = Consistency::of(&errors);
            prop_assert_eq!(consistency.unusable, 0);
            for part in [consistency.pose, consistency.depth, consistency.lateral, consistency.rotation] {
                let part = part.unwrap();
                prop_assert!(part.mean < 1e-12 && part.count == poses.len());
                prop_assert!(part.coverage.iter().all(|coverage| (coverage.share - 1.0).abs() < 1e-12));
            }
        }
    }
}
