//! A gRPC client that keeps to no rule but HTTP/2's.
#![allow(unreachable_pub, reason = "for the other modules of this test")]

use bytes::Bytes;
use h2::client::SendRequest;
use h2::{RecvStream, SendStream};
use http::{Request, Response};
use tokio::io::{AsyncRead, AsyncWrite};

use crate::support::Server;

pub struct RawClient {
    requests: SendRequest<Bytes>,
    /// What the server lets one connection have open.
    pub most_calls: usize,
}

/// An open call: its answer to come, and its upload.
pub struct RawCall {
    answer: h2::client::ResponseFuture,
    pub upload: SendStream<Bytes>,
}

impl RawClient {
    pub async fn connect(server: &Server) -> Self {
        Self::over(tokio::net::TcpStream::connect(server.grpc).await.unwrap()).await
    }

    pub async fn over(stream: impl AsyncRead + AsyncWrite + Send + Unpin + 'static) -> Self {
        let (requests, mut connection) = h2::client::handshake(stream).await.unwrap();
        // The server's settings come with its first bytes.
        let most_calls = loop {
            let poll = std::future::poll_fn(|context| {
                let _ = std::pin::Pin::new(&mut connection).poll(context);
                std::task::Poll::Ready(connection.max_concurrent_send_streams())
            });
            let most = poll.await;
            if most < usize::MAX >> 33 {
                break most;
            }
            tokio::time::sleep(std::time::Duration::from_millis(5)).await;
        };
        tokio::spawn(connection);
        Self { requests, most_calls }
    }

    pub async fn call(&mut self, method: &str, headers: &[(&str, &str)]) -> RawCall {
        let request = Request::post(format!("http://posed/posed.v1.PoseService/{method}"));
        let request = request.header("content-type", "application/grpc").header("te", "trailers");
        let request = headers.iter().fold(request, |request, (name, value)| request.header(*name, *value));
        self.requests = self.requests.clone().ready().await.unwrap();
        let (answer, upload) = self.requests.send_request(request.body(()).unwrap(), false).unwrap();
        RawCall { answer, upload }
    }
}

impl RawCall {
    /// A message as gRPC frames it.
    pub fn send(&mut self, message: &[u8], end: bool) {
        let length = u32::try_from(message.len()).unwrap().to_be_bytes();
        self.upload.send_data([&[0], &length[..], message].concat().into(), end).unwrap();
    }

    pub async fn answer(self) -> Response<RecvStream> {
        self.answer.await.unwrap()
    }

    /// The code of an answer that has nothing but an error, and its head.
    pub async fn refused(self) -> (String, Response<RecvStream>) {
        let answer = self.answer.await.unwrap();
        (answer.headers()["grpc-status"].to_str().unwrap().to_owned(), answer)
    }
}
