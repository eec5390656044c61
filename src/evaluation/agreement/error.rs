use thiserror::Error;

/// What cannot be compared.
#[derive(Clone, Debug, Error, PartialEq)]
pub enum AgreementError {
    #[error("the object's diameter must be positive, and its middle finite")]
    Shape,
    #[error("image {image_id}: a value of the pose, the covariance or the camera is not finite")]
    NotFinite { image_id: u32 },
    #[error("image {image_id}: the covariance of the pose is not positive definite")]
    Covariance { image_id: u32 },
    #[error("image {image_id}: the camera stands in the middle of the object; check 'cam_t_w2c'")]
    CameraInObject { image_id: u32 },
}
