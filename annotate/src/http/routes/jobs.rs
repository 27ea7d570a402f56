//! Imports, exports and other jobs.

use axum::body::Body;
use axum::http::header;
use axum::response::Response;

use crate::Error;
use crate::http::app::{Context, Reply, json, set};
use crate::jobs;
use crate::wire::{Code, ExportRequest, ImportFormat};

pub(super) fn import(cx: &Context) -> Result<Reply, Error> {
    cx.only(&["format"])?;
    let format = cx.one_of("format", ImportFormat::parse)?.ok_or_else(|| {
        Error::refused(
            Code::BadRequest,
            "format is missing: dataset, stance or annotations",
        )
    })?;
    let work = jobs::Import {
        format,
        dataset: cx.app.config.dataset.clone(),
        data: cx.app.config.data.clone(),
        body: cx.body.to_vec(),
    };
    let job = jobs::start_import(&cx.app.store, &cx.app.config.clock, cx.who()?.id, work)?;
    json(&job)
}

pub(super) fn export(cx: &Context) -> Result<Reply, Error> {
    let request: ExportRequest = cx.body()?;
    for split in &request.splits {
        split
            .parse::<datasets_spec::Split>()
            .map_err(|error| Error::invalid("splits", error.to_string()))?;
    }
    let job = jobs::start_export(
        &cx.app.store,
        &cx.app.config.clock,
        &cx.app.config.data,
        &cx.app.config.dataset,
        cx.who()?.id,
        request,
    )?;
    json(&job)
}

pub(super) fn all_jobs(cx: &Context) -> Result<Reply, Error> {
    jobs::abandon(&cx.app.store, cx.now)?;
    json(&cx.app.store.jobs()?)
}

fn job_of(cx: &Context) -> Result<crate::wire::Job, Error> {
    let id = cx.id()?;
    jobs::abandon(&cx.app.store, cx.now)?;
    let mut jobs = cx.app.store.jobs()?.into_iter();
    jobs.find(|job| job.id == id)
        .ok_or_else(|| Error::not_found("job"))
}

pub(super) fn one_job(cx: &Context) -> Result<Reply, Error> {
    json(&job_of(cx)?)
}

pub(super) fn job_file(cx: &Context) -> Result<Reply, Error> {
    let job = job_of(cx)?;
    // Only file names that the job lists become part of a path.
    let name = job
        .files
        .iter()
        .find(|known| *known == cx.param("name"))
        .ok_or_else(|| Error::not_found("file of this job"))?;
    let bytes = jobs::file(&cx.app.store, &cx.app.config.data, job.id, name)?;
    let mut response = Response::new(Body::from(bytes));
    set(
        &mut response,
        header::CONTENT_TYPE,
        "application/octet-stream",
    );
    set(&mut response, header::CACHE_CONTROL, "no-store");
    set(
        &mut response,
        header::CONTENT_DISPOSITION,
        &format!("attachment; filename=\"{name}\""),
    );
    Ok(Reply::Full(response))
}
