//! HTTP by hand, for clients that no library would make.

use std::net::SocketAddr;
use std::time::Duration;

use bytes::Bytes;
use tokio::io::{AsyncReadExt as _, AsyncWriteExt as _};
use tokio::net::{TcpSocket, TcpStream};

/// An image's head; the connection ends with its answer.
pub fn head(query: &str, headers: &str, length: usize) -> String {
    format!(
        "POST /v1/poses?camera=demo{query} HTTP/1.1\r\nhost: posed\r\nconnection: close\r\n{headers}content-length: {length}\r\n\r\n"
    )
}

/// Connects with a buffer for what comes that is as small as the system allows.
pub async fn narrow(address: SocketAddr) -> std::io::Result<TcpStream> {
    let socket = TcpSocket::new_v4()?;
    socket.set_recv_buffer_size(16 << 10)?;
    socket.connect(address).await
}

/// Sends in so many pieces, with a pause after each.
pub async fn drip(stream: &mut TcpStream, body: &Bytes, pieces: usize, pause: Duration) -> std::io::Result<()> {
    for piece in body.chunks(body.len().div_ceil(pieces)) {
        stream.write_all(piece).await?;
        tokio::time::sleep(pause).await;
    }
    Ok(())
}

/// An answer as it came.
pub struct Answer {
    pub status: u16,
    pub again: bool,
    pub body: Vec<u8>,
}

/// Reads to the end, with a pause after each piece.
pub async fn read(stream: &mut TcpStream, piece: usize, pause: Duration) -> Result<Answer, String> {
    let (mut bytes, mut buffer) = (Vec::new(), vec![0; piece]);
    loop {
        match stream.read(&mut buffer).await {
            Ok(0) => break,
            Ok(length) => bytes.extend_from_slice(&buffer[..length]),
            Err(error) => return Err(format!("broken after {} bytes of the answer: {error}", bytes.len())),
        }
        tokio::time::sleep(pause).await;
    }
    parse(&bytes).ok_or_else(|| format!("half an answer: {} bytes", bytes.len()))
}

/// `None` where something of it is missing.
fn parse(bytes: &[u8]) -> Option<Answer> {
    let end = bytes.windows(4).position(|window| window == b"\r\n\r\n")?;
    let head = std::str::from_utf8(&bytes[..end]).ok()?.to_ascii_lowercase();
    let status = head.split(' ').nth(1)?.parse().ok()?;
    let body = bytes[end + 4..].to_vec();
    let length: usize = head.lines().find_map(|line| line.strip_prefix("content-length: "))?.parse().ok()?;
    (body.len() == length).then(|| Answer { status, again: head.contains("\r\nretry-after: "), body })
}
