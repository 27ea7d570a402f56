//! Imports, exports and other jobs.

use axum::http::header::CONTENT_DISPOSITION;
use axum::response::{IntoResponse, Response};
use datasets_spec::Split;
use serde::Deserialize;

use crate::Error;
use crate::http::app::{Context, binary, json};
use crate::jobs;
use crate::wire::{Code, ExportRequest, ImportFormat, Job};

/// The query of `imports`.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct Import {
    format: Option<ImportFormat>,
}

pub(super) fn import(cx: &Context) -> Result<Response, Error> {
    let Import { format } = cx.query()?;
    let missing = "format is missing: dataset, stance or annotations";
    let format = format.ok_or_else(|| Error::refused(Code::BadRequest, missing))?;
    let body = cx.body.to_vec();
    json(&jobs::start_import(&cx.app, cx.user()?, format, body)?)
}

pub(super) fn export(cx: &Context) -> Result<Response, Error> {
    let request: ExportRequest = cx.body()?;
    for split in &request.splits {
        split
            .parse::<Split>()
            .map_err(|error| Error::invalid("splits", error.to_string()))?;
    }
    json(&jobs::start_export(&cx.app, cx.user()?, request)?)
}

/// The last jobs. Jobs of stopped servers are marked as failed first.
pub(super) fn all(cx: &Context) -> Result<Vec<Job>, Error> {
    cx.store().abandon(cx.now)?;
    cx.store().jobs()
}

pub(super) fn one(cx: &Context) -> Result<Job, Error> {
    let id = cx.id()?;
    let mut jobs = all(cx)?.into_iter();
    jobs.find(|job| job.id == id)
        .ok_or_else(|| Error::not_found("job"))
}

pub(super) fn file(cx: &Context) -> Result<Response, Error> {
    let job = one(cx)?;
    // Only file names that the job lists become part of a path.
    let mut names = job.files.iter();
    let name = names
        .find(|known| *known == cx.param("name"))
        .ok_or_else(|| Error::not_found("file of this job"))?;
    let bytes = jobs::file(cx.store(), &cx.app.config.data, job.id, name)?;
    let attachment = format!("attachment; filename=\"{name}\"");
    Ok(([(CONTENT_DISPOSITION, attachment)], binary(bytes)).into_response())
}
