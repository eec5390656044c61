//! Small networks, written as ONNX files: the parts of onnx.proto3 that they need.
#![allow(dead_code, unreachable_pub, reason = "each test file uses a part of this")]

use prost::Message;

#[derive(Clone, PartialEq, Message)]
pub struct Model {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(message, optional, tag = "7")]
    pub graph: Option<Graph>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<Opset>,
}

#[derive(Clone, PartialEq, Message)]
struct Opset {
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
pub struct Graph {
    #[prost(message, repeated, tag = "1")]
    pub nodes: Vec<Node>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    pub initializers: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    inputs: Vec<Value>,
    #[prost(message, repeated, tag = "12")]
    outputs: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
pub struct Node {
    #[prost(string, repeated, tag = "1")]
    inputs: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    outputs: Vec<String>,
    #[prost(string, tag = "4")]
    operator: String,
    #[prost(message, repeated, tag = "5")]
    pub attributes: Vec<Attribute>,
}

#[derive(Clone, PartialEq, Message)]
pub struct Attribute {
    #[prost(string, tag = "1")]
    pub name: String,
    #[prost(int64, tag = "3")]
    integer: i64,
    #[prost(message, optional, tag = "5")]
    pub tensor: Option<Tensor>,
    #[prost(message, optional, tag = "6")]
    pub graph: Option<Graph>,
    #[prost(int32, tag = "20")]
    kind: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    of: Option<Type>,
}

#[derive(Clone, PartialEq, Message)]
struct Type {
    #[prost(message, optional, tag = "1")]
    tensor: Option<TensorType>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorType {
    #[prost(int32, tag = "1")]
    element: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    sides: Vec<Side>,
}

#[derive(Clone, PartialEq, Message)]
struct Side {
    #[prost(int64, tag = "1")]
    value: i64,
}

#[derive(Clone, PartialEq, Message)]
pub struct Tensor {
    #[prost(int64, repeated, tag = "1")]
    sides: Vec<i64>,
    #[prost(int32, tag = "2")]
    element: i32,
    #[prost(bytes = "vec", repeated, tag = "6")]
    strings: Vec<Vec<u8>>,
    #[prost(string, tag = "8")]
    name: String,
    #[prost(bytes = "vec", tag = "9")]
    raw: Vec<u8>,
    #[prost(message, repeated, tag = "13")]
    external: Vec<Entry>,
    #[prost(int32, tag = "14")]
    location: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Entry {
    #[prost(string, tag = "1")]
    key: String,
    #[prost(string, tag = "2")]
    value: String,
}

/// ONNX's numbers of element types.
#[derive(Clone, Copy, PartialEq, Eq)]
pub enum Element {
    Float = 1,
    Uint8 = 2,
    Int32 = 6,
    Int64 = 7,
    String = 8,
    Bool = 9,
    Half = 10,
}

impl Tensor {
    fn raw(name: &str, shape: &[i64], element: Element, raw: Vec<u8>) -> Self {
        Self { name: name.into(), sides: shape.into(), element: element as i32, raw, ..Self::default() }
    }

    pub fn floats(name: &str, shape: &[i64], values: &[f32]) -> Self {
        Self::raw(name, shape, Element::Float, values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    pub fn int64s(name: &str, shape: &[i64], values: &[i64]) -> Self {
        Self::raw(name, shape, Element::Int64, values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    pub fn int32s(name: &str, shape: &[i64], values: &[i32]) -> Self {
        Self::raw(name, shape, Element::Int32, values.iter().flat_map(|v| v.to_le_bytes()).collect())
    }

    pub fn bools(name: &str, shape: &[i64], values: &[bool]) -> Self {
        Self::raw(name, shape, Element::Bool, values.iter().map(|v| u8::from(*v)).collect())
    }

    pub fn strings(name: &str, values: &[&str]) -> Self {
        let strings = values.iter().map(|text| text.as_bytes().to_vec()).collect();
        Self { strings, ..Self::raw(name, &[i64::try_from(values.len()).unwrap()], Element::String, Vec::new()) }
    }

    /// Bytes that lie in a file.
    pub fn elsewhere(name: &str, length: i64, file: &str) -> Self {
        let entry = |key: &str, value: &str| Entry { key: key.into(), value: value.into() };
        let external = vec![entry("location", file), entry("offset", "0"), entry("length", &length.to_string())];
        Self { external, location: 1, ..Self::raw(name, &[length], Element::Uint8, Vec::new()) }
    }
}

impl Attribute {
    pub fn integer(name: &str, value: i64) -> Self {
        Self { name: name.into(), integer: value, kind: 2, ..Self::default() }
    }

    pub fn tensor(name: &str, tensor: Tensor) -> Self {
        Self { name: name.into(), tensor: Some(tensor), kind: 4, ..Self::default() }
    }

    pub fn graph(name: &str, graph: Graph) -> Self {
        Self { name: name.into(), graph: Some(graph), kind: 5, ..Self::default() }
    }
}

impl Node {
    pub fn new(operator: &str, inputs: &[&str], output: &str) -> Self {
        let inputs = inputs.iter().map(|name| (*name).into()).collect();
        Self { operator: operator.into(), inputs, outputs: vec![output.into()], ..Self::default() }
    }

    pub fn cast(input: &str, output: &str, to: Element) -> Self {
        Self::new("Cast", &[input], output).with(Attribute::integer("to", to as i64))
    }

    pub fn with(mut self, attribute: Attribute) -> Self {
        self.attributes.push(attribute);
        self
    }
}

fn value(name: &str, element: Element, shape: Option<&[i64]>) -> Value {
    let shape = shape.map(|sides| Shape { sides: sides.iter().map(|value| Side { value: *value }).collect() });
    let tensor = Some(TensorType { element: element as i32, shape });
    Value { name: name.into(), of: Some(Type { tensor }) }
}

impl Graph {
    pub fn input(mut self, name: &str, element: Element, shape: &[i64]) -> Self {
        self.inputs.push(value(name, element, Some(shape)));
        self
    }

    pub fn node(mut self, node: Node) -> Self {
        self.nodes.push(node);
        self
    }

    pub fn constant(mut self, tensor: Tensor) -> Self {
        self.initializers.push(tensor);
        self
    }

    pub fn output(mut self, name: &str, element: Element) -> Self {
        self.outputs.push(value(name, element, None));
        self
    }

    /// An output that is always the same.
    pub fn answer(self, tensor: Tensor) -> Self {
        let name = tensor.name.clone();
        let element = [Element::Float, Element::Int32, Element::Int64, Element::String, Element::Bool];
        let element = *element.iter().find(|element| **element as i32 == tensor.element).unwrap();
        let constant = format!("{name}_constant");
        let node = Node::new("Identity", &[&constant], &name);
        self.constant(Tensor { name: constant, ..tensor }).node(node).output(&name, element)
    }

    /// The file.
    pub fn file(mut self) -> Vec<u8> {
        self.name = "graph".into();
        let opset_import = vec![Opset { domain: String::new(), version: 18 }];
        Model { ir_version: 9, graph: Some(self), opset_import }.encode_to_vec()
    }

    /// What, behind the bytes of a file, adds this to its graph.
    pub fn addition(self) -> Vec<u8> {
        Model { graph: Some(self), ..Model::default() }.encode_to_vec()
    }
}
