use half::f16;
use ort::session::Session;
use ort::value::{DynValue, Outlet, TensorRef};

use super::network::{Input, Network, Output, Outputs, RuntimeError, SizeInput};

/// How many images a session takes at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Batch {
    /// Whatever the network takes.
    Any,
    Of(usize),
}

/// A network of ONNX Runtime: one session, or one for each size of batch.
pub(super) struct OnnxNetwork {
    name: String,
    /// The largest batch first.
    sessions: Vec<(Batch, Session)>,
    /// Name of the image's input.
    image: String,
    /// Another input, and the width and height that it is given.
    size: Option<(String, [i64; 2])>,
}

impl OnnxNetwork {
    pub(super) fn new(
        name: &str,
        mut sessions: Vec<(Batch, Session)>,
        size: Option<SizeInput<'_>>,
    ) -> Result<Self, String> {
        sessions.sort_by_key(|(batch, _)| std::cmp::Reverse(batch.largest()));
        let image = sessions.first().map_or(Ok(String::new()), |(_, session)| image_input(session, size))?;
        let size = size.map(|size| (size.name.to_owned(), [size.width, size.height].map(i64::from)));
        Ok(Self { name: name.into(), sessions, image, size })
    }

    /// Runs the largest batch that fits; returns how many images it was.
    fn run_some(&mut self, input: Input<'_>) -> Result<(usize, Outputs), RuntimeError> {
        let images = input.images();
        let failed = |error: ort::Error| RuntimeError::Run { name: self.name.clone(), reason: error.to_string() };
        let (batch, session) = self
            .sessions
            .iter_mut()
            .find(|(batch, _)| batch.fits(images))
            .ok_or_else(|| RuntimeError::Run { name: self.name.clone(), reason: "it was given no image".into() })?;
        let images = match batch {
            Batch::Any => images,
            Batch::Of(size) => *size,
        };
        let input: ort::session::SessionInputValue<'_> = match input.slice(0..images) {
            Input::Bytes { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
            Input::Floats { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
            Input::Halves { shape, values } => TensorRef::from_array_view((shape, values)).map_err(failed)?.into(),
        };
        let mut inputs = vec![(self.image.as_str(), input)];
        if let Some((name, size)) = &self.size {
            let size = TensorRef::from_array_view(([1, size.len()], size.as_slice())).map_err(failed)?;
            inputs.push((name, size.into()));
        }
        let results = session.run(inputs).map_err(failed)?;
        let (mut tensors, mut others) = (Vec::with_capacity(results.len()), Vec::new());
        for (name, value) in &results {
            match numbers(&value) {
                Some((shape, values)) => tensors.push(Output { name: name.to_owned(), shape, values }),
                None => others.push(name.to_owned()),
            }
        }
        Ok((images, Outputs { network: self.name.clone(), tensors, others }))
    }
}

impl Batch {
    fn largest(self) -> usize {
        match self {
            Self::Any => usize::MAX,
            Self::Of(size) => size,
        }
    }

    fn fits(self, images: usize) -> bool {
        self == Self::Any || self.largest() <= images
    }
}

impl Network for OnnxNetwork {
    fn run(&mut self, input: Input<'_>) -> Result<Outputs, RuntimeError> {
        let (mut done, mut outputs) = self.run_some(input)?;
        while done < input.images() {
            let (images, more) = self.run_some(input.slice(done..input.images()))?;
            outputs.append(more)?;
            done += images;
        }
        Ok(outputs)
    }
}

/// The name of the input that is the image: the only one beside that for the size.
fn image_input(session: &Session, size: Option<SizeInput<'_>>) -> Result<String, String> {
    let names: Vec<&str> = session.inputs().iter().map(Outlet::name).collect();
    let others: Vec<&str> = names.iter().copied().filter(|name| size.is_none_or(|size| size.name != *name)).collect();
    if let Some(SizeInput { name, .. }) = size.filter(|_| others.len() == names.len()) {
        return Err(format!("it has no input {name:?} ('input.size_input'); its inputs are {names:?}"));
    }
    match others[..] {
        [image] => Ok(image.to_owned()),
        _ => Err(format!(
            "its inputs are {names:?}, but only an image is given; if one is for the size of the image, as              \"orig_target_sizes\" of a detector, name it in 'input.size_input'"
        )),
    }
}

/// A tensor's shape and values. Exporters differ in the types of class indices and counts.
#[expect(clippy::cast_precision_loss, clippy::cast_possible_truncation, reason = "class indices, counts and pixels")]
fn numbers(value: &DynValue) -> Option<(Vec<usize>, Vec<f32>)> {
    fn read<T>(value: &DynValue, float: impl Fn(&T) -> f32) -> Option<(Vec<usize>, Vec<f32>)>
    where
        T: ort::value::PrimitiveTensorElementType + std::fmt::Debug,
    {
        let (shape, values) = value.try_extract_tensor::<T>().ok()?;
        let sides = shape.iter().map(|side| usize::try_from(*side).unwrap_or(0)).collect();
        Some((sides, values.iter().map(float).collect()))
    }
    read::<f32>(value, |v| *v)
        .or_else(|| read::<f16>(value, |v| v.to_f32()))
        .or_else(|| read::<i64>(value, |v| *v as f32))
        .or_else(|| read::<i32>(value, |v| *v as f32))
        .or_else(|| read::<f64>(value, |v| *v as f32))
}
