//! Protobuf, but for messages of so many fields that they take many times their own size in memory.

use std::marker::PhantomData;

use bytes::Buf as _;
use prost::Message;
use prost::encoding::{WireType, decode_key, decode_varint};
use tonic::Status;
use tonic::codec::{Codec, DecodeBuf, Decoder};
use tonic_prost::{ProstDecoder, ProstEncoder};

/// An honest request has some dozens; a name of an object alone takes 24 bytes for the two that announce it.
const MAX_FIELDS: usize = 1024;
/// Requests lie in frames, frames in requests of a stream, each as a field of this number. Images lie elsewhere.
const NESTED: u32 = 2;
const MAX_DEPTH: usize = 3;

/// As `tonic_prost::ProstCodec`, with a limit on fields.
pub struct BoundedCodec<T, U>(PhantomData<(T, U)>);

/// Decodes what [`BoundedCodec`] lets through.
pub struct BoundedDecoder<U>(ProstDecoder<U>);

impl<T, U> Default for BoundedCodec<T, U> {
    fn default() -> Self {
        Self(PhantomData)
    }
}

impl<T, U> Codec for BoundedCodec<T, U>
where
    T: Message + Send + 'static,
    U: Message + Default + Send + 'static,
{
    type Encode = T;
    type Decode = U;
    type Encoder = ProstEncoder<T>;
    type Decoder = BoundedDecoder<U>;

    fn encoder(&mut self) -> Self::Encoder {
        ProstEncoder::default()
    }

    fn decoder(&mut self) -> Self::Decoder {
        BoundedDecoder(ProstDecoder::default())
    }
}

impl<U: Message + Default> Decoder for BoundedDecoder<U> {
    type Item = U;
    type Error = Status;

    fn decode(&mut self, message: &mut DecodeBuf<'_>) -> Result<Option<U>, Status> {
        // The whole message lies in one piece.
        if count_fields(message.chunk(), MAX_DEPTH) > MAX_FIELDS {
            return Err(Status::invalid_argument(format!(
                "the message has more than {MAX_FIELDS} fields; name fewer objects"
            )));
        }
        // Whoever sent it is at fault, not whoever reads it.
        self.0
            .decode(message)
            .map_err(|status| Status::invalid_argument(format!("the message cannot be decoded: {}", status.message())))
    }
}

/// Fields of a message and of those in it that may hold a request; up to one more than the limit. What is no message has
/// the fields before its fault.
fn count_fields(mut message: &[u8], depth: usize) -> usize {
    let mut count = 0;
    while count <= MAX_FIELDS && message.has_remaining() {
        let Ok((number, kind)) = decode_key(&mut message) else { return count };
        count += 1;
        let length = match kind {
            WireType::Varint => decode_varint(&mut message).map(|_| 0),
            WireType::LengthDelimited => decode_varint(&mut message),
            WireType::SixtyFourBit => Ok(8),
            WireType::ThirtyTwoBit => Ok(4),
            WireType::StartGroup | WireType::EndGroup => Ok(0),
        };
        let Some(field) = length.ok().and_then(|length| message.get(..usize::try_from(length).ok()?)) else {
            return count;
        };
        if number == NESTED && kind == WireType::LengthDelimited && depth > 0 {
            count += count_fields(field, depth - 1);
        }
        message = &message[field.len()..];
    }
    count
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::proto::estimate_stream_request::Kind;
    use crate::proto::{EstimateRequest, EstimateStreamRequest, Frame};

    fn frame(names: usize) -> Vec<u8> {
        let request = EstimateRequest {
            image: vec![0x0A; 5000].into(),
            objects: vec!["cube".into(); names],
            ..EstimateRequest::default()
        };
        let frame = Frame { frame_id: 7, request: Some(request), capture_time: None };
        EstimateStreamRequest { kind: Some(Kind::Frame(frame)) }.encode_to_vec()
    }

    #[test]
    fn fields_are_counted_where_requests_lie_and_images_are_not() {
        // The frame, its id, the request, its image.
        assert_eq!(count_fields(&frame(0), MAX_DEPTH), 4);
        assert_eq!(count_fields(&frame(100), MAX_DEPTH), 104);
        assert!(count_fields(&frame(5000), MAX_DEPTH) > MAX_FIELDS);
        assert!(count_fields(&[0xFF; 50], MAX_DEPTH) <= 1);
    }
}
