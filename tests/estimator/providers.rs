//! The demo's networks on every provider that runs here.

use posed::model::{Backend, Input, LoadOptions, Network, Outputs, ProviderSetting};

use crate::script::runtime;

const SIDE: usize = 160;

/// The crops that the trainer left with the cube: three of them.
fn crops() -> Vec<u8> {
    image::open("models/cube/parity.png").unwrap().into_rgb8().into_raw()
}

fn run(network: &mut dyn Network, crops: &[u8]) -> Outputs {
    let shape = [crops.len() / (SIDE * SIDE * 3), SIDE, SIDE, 3];
    network.run(Input::Bytes { shape, values: crops }).unwrap()
}

fn networks() -> Vec<Box<dyn Network>> {
    let bytes = std::fs::read("models/cube/keypoints.onnx").unwrap();
    let options = LoadOptions { size: None, batches: &[1, 2] };
    let here = [ProviderSetting::Cpu, ProviderSetting::Openvino].into_iter();
    here.filter_map(|provider| Some(runtime().with(provider, 2).ok()?.load("cube", &bytes, options).unwrap())).collect()
}

/// Distances of the keypoints of some crops from those of others, in ascending order.
fn distances(outputs: &Outputs, others: &Outputs) -> Vec<f32> {
    let [found, expected] = [outputs, others].map(|outputs| outputs.named("keypoints").unwrap());
    assert_eq!(found.shape, expected.shape);
    let pairs = found.values.chunks_exact(2).zip(expected.values.chunks_exact(2));
    let mut distances: Vec<f32> = pairs.map(|(a, b)| (a[0] - b[0]).hypot(a[1] - b[1])).collect();
    distances.sort_by(f32::total_cmp);
    distances
}

#[test]
fn a_batch_of_any_size_is_answered_as_its_crops_alone() {
    let crops = crops();
    let each = crops.len() / 3;
    for mut network in networks() {
        let mut alone = run(&mut *network, &crops[..each]);
        for crop in crops.chunks_exact(each).skip(1).chain(crops.chunks_exact(each)) {
            alone.append(run(&mut *network, crop)).unwrap();
        }
        let together = run(&mut *network, &crops.repeat(2));
        assert!(*distances(&together, &alone).last().unwrap() < 0.05);
        for name in ["covariances", "peaks", "second_weights", "unfamiliarity"] {
            assert_eq!(together.named(name).unwrap().shape[0], 6, "{name}");
        }
    }
}

#[test]
fn providers_round_differently_and_agree() {
    let crops = crops();
    let mut networks = networks();
    let answers: Vec<Outputs> = networks.iter_mut().map(|network| run(&mut **network, &crops)).collect();
    for other in &answers[1..] {
        let distances = distances(other, &answers[0]);
        assert!(distances[distances.len() / 2] < 1.0, "{distances:?}");
    }
}
