//! Errors of the libraries as exceptions of Python.

use std::error::Error;

use datasets_spec::Code;
use pyo3::prelude::*;

/// Fields of a `stance.Error`: message, code and item.
#[derive(Debug)]
pub(crate) struct Failure {
    message: String,
    code: Option<Code>,
}

impl Failure {
    /// A failure without a code.
    pub(crate) fn new(message: impl Into<String>) -> Self {
        Self {
            message: message.into(),
            code: None,
        }
    }

    fn of(error: &dyn Error, code: Option<Code>) -> Self {
        let mut message = error.to_string();
        let mut cause = error.source();
        while let Some(inner) = cause {
            message = format!("{message}: {inner}");
            cause = inner.source();
        }
        Self { message, code }
    }
}

macro_rules! coded {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                let code = error.code();
                Self::of(&error, code)
            }
        }
    )*};
}

macro_rules! plain {
    ($($error:ty),*) => {$(
        impl From<$error> for Failure {
            fn from(error: $error) -> Self {
                Self::of(&error, None)
            }
        }
    )*};
}

coded!(
    datasets_spec::Error,
    pipeline::Error,
    compose::Error,
    formats::Error,
    train::Error,
    eval::Error
);
plain!(
    corpus::Error,
    kinematics::Error,
    features::humanml3d::FeatureError,
    serde_json::Error,
    std::io::Error,
    train::config::SettingError
);

impl From<clip::Rejected> for Failure {
    fn from(rejected: clip::Rejected) -> Self {
        Self {
            message: rejected.to_string(),
            code: Some((rejected.code, None)),
        }
    }
}

impl From<Failure> for PyErr {
    fn from(failure: Failure) -> Self {
        Python::attach(|py| {
            let (code, item) = failure.code.unwrap_or(("E-FAILED", None));
            let raised = py
                .import("stance._errors")
                .and_then(|module| module.getattr("Error"))
                .and_then(|kind| kind.call1((failure.message, code, item)));
            match raised {
                Ok(error) => Self::from_value(error),
                Err(error) => error,
            }
        })
    }
}
