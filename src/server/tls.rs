//! TLS for clients' ports.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use thiserror::Error;
use tokio_rustls::TlsAcceptor;
use tokio_rustls::rustls::ServerConfig;
use tokio_rustls::rustls::crypto::ring;
use tokio_rustls::rustls::pki_types::pem::{self, PemObject as _};
use tokio_rustls::rustls::pki_types::{CertificateDer, PrivateKeyDer};

use crate::model::read_regular;

const MAX_FILE_BYTES: u64 = 1 << 20;

/// A certificate or a key that cannot be used.
#[derive(Debug, Error)]
pub enum TlsError {
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error("{} has no usable {what} in PEM form: {source}", path.display())]
    Pem { path: PathBuf, what: &'static str, source: pem::Error },
    #[error("{} and {} cannot be used together: {source}", certificate.display(), key.display())]
    Pair { certificate: PathBuf, key: PathBuf, source: tokio_rustls::rustls::Error },
}

/// The certificate in force. Clones are one.
#[derive(Clone)]
pub(super) struct Tls(Arc<Files>);

struct Files {
    certificate: PathBuf,
    key: PathBuf,
    config: RwLock<Arc<ServerConfig>>,
}

impl Tls {
    /// # Errors
    /// [`TlsError`] names the file.
    pub(super) fn read(certificate: &Path, key: &Path) -> Result<Self, TlsError> {
        let config = RwLock::new(Arc::new(read(certificate, key)?));
        Ok(Self(Arc::new(Files { certificate: certificate.into(), key: key.into(), config })))
    }

    /// Reads the files again; the old certificate stays in force where they cannot be used.
    pub(super) fn reload(&self) {
        match read(&self.0.certificate, &self.0.key) {
            Ok(config) => {
                tracing::info!("the certificate is read again");
                *self.0.config.write().unwrap_or_else(PoisonError::into_inner) = Arc::new(config);
            }
            Err(error) => tracing::error!(%error, "the old certificate stays in force"),
        }
    }

    /// What greets a new connection that speaks `protocol`.
    pub(super) fn acceptor(&self, protocol: &[u8]) -> TlsAcceptor {
        let mut config = self.0.config.read().unwrap_or_else(PoisonError::into_inner).as_ref().clone();
        config.alpn_protocols = vec![protocol.to_vec()];
        Arc::new(config).into()
    }
}

fn read(certificate: &Path, key: &Path) -> Result<ServerConfig, TlsError> {
    let bytes =
        |path: &Path| read_regular(path, MAX_FILE_BYTES).map_err(|source| TlsError::Read { path: path.into(), source });
    let not_pem = |path: &Path, what| {
        let path = path.to_path_buf();
        move |source| TlsError::Pem { path, what, source }
    };
    let chain = CertificateDer::pem_slice_iter(&bytes(certificate)?).collect::<Result<Vec<_>, _>>();
    let chain = chain.and_then(|chain| if chain.is_empty() { Err(pem::Error::NoItemsFound) } else { Ok(chain) });
    let chain = chain.map_err(not_pem(certificate, "certificate"))?;
    let private = PrivateKeyDer::from_pem_slice(&bytes(key)?).map_err(not_pem(key, "private key"))?;
    let pair = |source| TlsError::Pair { certificate: certificate.into(), key: key.into(), source };
    ServerConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .and_then(|builder| builder.with_no_client_auth().with_single_cert(chain, private))
        .map_err(pair)
}
