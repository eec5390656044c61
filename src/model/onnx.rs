//! What an ONNX file refers to, read before ONNX Runtime sees it.
//!
//! Weights may lie in another file, which ONNX Runtime would look for in the working folder, and which no hash covers.
//! The messages below are those parts of onnx.proto3 in which a tensor can be.

use prost::Message;

#[derive(Clone, PartialEq, Message)]
struct Model {
    #[prost(message, optional, tag = "7")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "25")]
    functions: Vec<Function>,
}

#[derive(Clone, PartialEq, Message)]
struct Function {
    #[prost(message, repeated, tag = "7")]
    nodes: Vec<Node>,
}

#[derive(Clone, PartialEq, Message)]
struct Graph {
    #[prost(message, repeated, tag = "1")]
    nodes: Vec<Node>,
    #[prost(message, repeated, tag = "5")]
    initializers: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    inputs: Vec<Value>,
    #[prost(message, repeated, tag = "15")]
    sparse_initializers: Vec<SparseTensor>,
}

#[derive(Clone, PartialEq, Message)]
struct Node {
    #[prost(string, tag = "4")]
    operator: String,
    #[prost(message, repeated, tag = "5")]
    attributes: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
struct Attribute {
    #[prost(message, optional, tag = "5")]
    tensor: Option<Tensor>,
    #[prost(message, optional, tag = "6")]
    graph: Option<Graph>,
    #[prost(message, repeated, tag = "10")]
    tensors: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    graphs: Vec<Graph>,
    #[prost(message, optional, tag = "22")]
    sparse_tensor: Option<SparseTensor>,
    #[prost(message, repeated, tag = "23")]
    sparse_tensors: Vec<SparseTensor>,
}

#[derive(Clone, PartialEq, Message)]
struct SparseTensor {
    #[prost(message, optional, tag = "1")]
    values: Option<Tensor>,
    #[prost(message, optional, tag = "2")]
    indices: Option<Tensor>,
}

#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(string, tag = "8")]
    name: String,
    #[prost(message, repeated, tag = "13")]
    external_data: Vec<Entry>,
    #[prost(int32, tag = "14")]
    data_location: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Entry {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    kind: Option<Type>,
}

#[derive(Clone, PartialEq, Message)]
struct Type {
    #[prost(message, optional, tag = "1")]
    tensor: Option<TensorType>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    axes: Vec<Axis>,
}

#[derive(Clone, PartialEq, Message)]
struct Axis {
    /// Of an axis of any size.
    #[prost(string, tag = "2")]
    name: String,
}

/// ONNX Runtime's own format says so in these bytes; it is not read here, so it is not loaded either.
const ORT_FORMAT: (std::ops::Range<usize>, &[u8]) = (4..8, b"ORTM");

/// A network that is whole.
pub(super) struct OnnxFile {
    batch_axis: Option<String>,
}

impl OnnxFile {
    /// Reads what is needed, and checks that it is an ONNX file, and that nothing of it lies in other files.
    pub(super) fn read(bytes: &[u8]) -> Result<Self, String> {
        if bytes.get(ORT_FORMAT.0) == Some(ORT_FORMAT.1) {
            return Err("it is in ONNX Runtime's own format; export it as an ONNX file".into());
        }
        let model = Model::decode(bytes).map_err(|error| format!("it is no ONNX file: {error}"))?;
        let graph = model.graph.ok_or("it is no ONNX file: it has no graph")?;
        graph.check()?;
        check_nodes(model.functions.iter().flat_map(|function| &function.nodes))?;
        Ok(Self { batch_axis: graph.batch_axis() })
    }

    /// The name of the axis along which its images lie, if it takes any number of them.
    pub(super) fn batch_axis(&self) -> Option<&str> {
        self.batch_axis.as_deref()
    }
}

fn check_nodes<'a>(nodes: impl IntoIterator<Item = &'a Node>) -> Result<(), String> {
    for node in nodes {
        if node.operator == "EPContext" {
            return Err(
                "it is compiled for a device (EPContext), which may refer to other files; export it as plain ONNX"
                    .into(),
            );
        }
        for attribute in &node.attributes {
            attribute.graph.iter().chain(&attribute.graphs).try_for_each(Graph::check)?;
            let sparse = attribute.sparse_tensor.iter().chain(&attribute.sparse_tensors);
            check_tensors(
                attribute.tensor.iter().chain(&attribute.tensors).chain(sparse.flat_map(SparseTensor::parts)),
            )?;
        }
    }
    Ok(())
}

fn check_tensors<'a>(tensors: impl IntoIterator<Item = &'a Tensor>) -> Result<(), String> {
    let elsewhere = |tensor: &&Tensor| tensor.data_location != 0 || !tensor.external_data.is_empty();
    match tensors.into_iter().find(elsewhere) {
        None => Ok(()),
        Some(tensor) => {
            let location = tensor.external_data.iter().find(|entry| entry.key == "location");
            Err(format!(
                "tensor {:?} lies in another file ({:?}); embed the weights: \
                 onnx.save(onnx.load(\"model.onnx\"), \"embedded.onnx\"), and state the new sha256",
                tensor.name,
                location.map_or("", |entry| &entry.value)
            ))
        }
    }
}

impl Graph {
    /// The first axis of the image: of the only input with four. Older files list weights among the inputs.
    fn batch_axis(&self) -> Option<String> {
        let is_weight = |value: &&Value| self.initializers.iter().any(|tensor| tensor.name == value.name);
        let axes = |value: &Value| Some(value.kind.clone()?.tensor?.shape?.axes);
        let inputs = self.inputs.iter().filter(|value| !is_weight(value)).filter_map(axes);
        let mut images = inputs.filter(|axes| axes.len() == 4);
        let image = images.next().filter(|_| images.next().is_none())?;
        image.into_iter().next().map(|axis| axis.name).filter(|name| !name.is_empty())
    }

    fn check(&self) -> Result<(), String> {
        check_tensors(self.initializers.iter().chain(self.sparse_initializers.iter().flat_map(SparseTensor::parts)))?;
        check_nodes(&self.nodes)
    }
}

impl SparseTensor {
    fn parts(&self) -> impl Iterator<Item = &Tensor> {
        self.values.iter().chain(&self.indices)
    }
}
