//! Who may do what: bearer tokens, known by their hashes.

use std::path::{Path, PathBuf};
use std::sync::{Arc, PoisonError, RwLock};

use sha2::{Digest as _, Sha256};
use subtle::ConstantTimeEq as _;
use thiserror::Error;

use super::failure::{Failure, FailureKind};
use crate::model::read_regular;

/// What a token may be used for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scope {
    /// What every token is good for.
    Any,
    /// Poses.
    Estimate,
    /// New references.
    Calibrate,
    /// Objects that come and go.
    Objects,
    /// Metrics and the log level.
    Admin,
}

const SCOPES: [(&str, Scope); 4] = [
    ("estimate", Scope::Estimate),
    ("calibrate", Scope::Calibrate),
    ("objects", Scope::Objects),
    ("admin", Scope::Admin),
];
const MAX_FILE_BYTES: u64 = 1 << 20;

/// A file of tokens that cannot be used.
#[derive(Debug, Error)]
pub(crate) enum AccessError {
    #[error("cannot read the tokens {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    #[error(
        "{}, line {line}: {problem}; each line has the SHA-256 of a token in 64 hexadecimal digits and its scopes, for \
         example `9f86…0a08 estimate,calibrate`", path.display()
    )]
    Line { path: PathBuf, line: usize, problem: String },
    #[error("{}: no token; nobody could use the server", path.display())]
    Empty { path: PathBuf },
}

/// The tokens in force. Clones are one; without a file everybody may do everything.
#[derive(Clone, Default)]
pub(crate) struct Access(Option<Arc<TokenFile>>);

struct TokenFile {
    path: PathBuf,
    tokens: RwLock<Vec<Token>>,
}

struct Token {
    sha256: [u8; 32],
    scopes: Vec<Scope>,
}

impl Access {
    /// # Errors
    /// [`AccessError`] names the file and the line.
    pub(crate) fn read(path: Option<&Path>) -> Result<Self, AccessError> {
        let read = |path: &Path| Ok(TokenFile { path: path.into(), tokens: RwLock::new(read(path)?) });
        Ok(Self(path.map(read).transpose()?.map(Arc::new)))
    }

    /// Reads the file again; the old tokens stay in force where it cannot be used.
    pub(crate) fn reload(&self) {
        let Some(file) = &self.0 else { return };
        match read(&file.path) {
            Ok(tokens) => {
                tracing::info!("{} tokens are in force", tokens.len());
                // A whole list is replaced: valid whoever panicked beside it.
                *file.tokens.write().unwrap_or_else(PoisonError::into_inner) = tokens;
            }
            Err(error) => tracing::error!(%error, "the old tokens stay in force"),
        }
    }

    /// Whether a caller with this `authorization` may do something.
    ///
    /// # Errors
    /// [`FailureKind::Unauthenticated`] for a stranger, [`FailureKind::Forbidden`] without the scope.
    pub(crate) fn check(&self, authorization: Option<&[u8]>, scope: Scope) -> Result<(), Failure> {
        let Some(file) = &self.0 else { return Ok(()) };
        let token = authorization.and_then(bearer).ok_or_else(|| {
            let message = "this server needs a token; send the header 'authorization: Bearer TOKEN'";
            Failure::new(FailureKind::Unauthenticated, message)
        })?;
        let sha256: [u8; 32] = Sha256::digest(token).into();
        let tokens = file.tokens.read().unwrap_or_else(PoisonError::into_inner);
        // Every one is compared to its end, so that the time tells nothing.
        let equal = |known: &&Token| bool::from(known.sha256.ct_eq(&sha256));
        let known = tokens.iter().filter(equal).fold(None, |_, token| Some(token));
        let known = known.ok_or_else(|| Failure::new(FailureKind::Unauthenticated, "the token is not known"))?;
        if scope == Scope::Any || known.scopes.contains(&scope) {
            return Ok(());
        }
        let name = SCOPES.iter().find(|(_, named)| *named == scope).map_or("", |(name, _)| name);
        Err(Failure::new(FailureKind::Forbidden, format!("the token does not have the scope '{name}'")))
    }
}

/// The token of `Bearer TOKEN`.
fn bearer(authorization: &[u8]) -> Option<&[u8]> {
    let (scheme, token) = authorization.split_at_checked(b"Bearer ".len())?;
    (scheme.eq_ignore_ascii_case(b"Bearer ") && !token.is_empty()).then(|| token.trim_ascii())
}

fn read(path: &Path) -> Result<Vec<Token>, AccessError> {
    let read = read_regular(path, MAX_FILE_BYTES);
    let bytes = read.map_err(|source| AccessError::Read { path: path.into(), source })?;
    let text = String::from_utf8_lossy(&bytes);
    let lines = text.lines().map(|line| line.split('#').next().unwrap_or_default().trim()).enumerate();
    let tokens = lines.filter(|(_, line)| !line.is_empty()).map(|(index, line)| {
        Token::parse(line).map_err(|problem| AccessError::Line { path: path.into(), line: index + 1, problem })
    });
    let tokens = tokens.collect::<Result<Vec<_>, _>>()?;
    if tokens.is_empty() { Err(AccessError::Empty { path: path.into() }) } else { Ok(tokens) }
}

impl Token {
    fn parse(line: &str) -> Result<Self, String> {
        let (hash, scopes) = line.split_once(char::is_whitespace).ok_or("it has no scopes")?;
        let scope = |name: &str| {
            let known = SCOPES.iter().find(|(known, _)| *known == name.trim());
            let refusal = || format!("unknown scope {:?}; use estimate, calibrate, objects and admin", name.trim());
            known.map(|(_, scope)| *scope).ok_or_else(refusal)
        };
        let sha256 = of_hex(hash).ok_or("it does not begin with 64 hexadecimal digits")?;
        Ok(Self { sha256, scopes: scopes.split(',').map(scope).collect::<Result<_, _>>()? })
    }
}

fn of_hex(text: &str) -> Option<[u8; 32]> {
    if text.len() != 64 || !text.bytes().all(|digit| digit.is_ascii_hexdigit()) {
        return None;
    }
    let mut bytes = [0; 32];
    for (index, byte) in bytes.iter_mut().enumerate() {
        *byte = u8::from_str_radix(text.get(2 * index..2 * index + 2)?, 16).ok()?;
    }
    Some(bytes)
}
