//! The SQL function `stance_piece(plan, piece)`: it makes a piece and returns its record.

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Instant;

use datafusion::arrow::array::{Array, ArrayRef, AsArray, StringArray, StructArray};
use datafusion::arrow::datatypes::{DataType, Field, Fields};
use datafusion::common::{Result, exec_err};
use datafusion::logical_expr::{
    ColumnarValue, ScalarFunctionArgs, ScalarUDF, ScalarUDFImpl, Signature, Volatility,
};
use pipeline::jobs::jobs;
use work::{Failed, Outcome, Record, Worker};

/// Name of the function, on scheduler, executors and client.
pub(crate) const NAME: &str = "stance_piece";

/// How pieces are made: in this process, or each in a child process.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
pub(crate) enum Isolation {
    /// A crash of a piece ends the executor.
    #[default]
    None,
    /// A child process of `stance` makes the piece, so a crash fails only that piece.
    Child(PathBuf),
}

/// The function. Its result is one struct column, which a query must take whole: the optimiser evaluates the function
/// again for each field that the query projects.
#[derive(Debug, PartialEq, Eq, Hash)]
struct MakePiece {
    signature: Signature,
    isolation: Isolation,
}

/// The function to register. Scheduler and client never call it.
pub(crate) fn function(isolation: Isolation) -> ScalarUDF {
    ScalarUDF::new_from_impl(MakePiece {
        signature: Signature::exact(vec![DataType::Utf8, DataType::Utf8], Volatility::Volatile),
        isolation,
    })
}

/// Fields of the result: the id of the piece, and its record as JSON.
fn fields() -> Fields {
    Fields::from(vec![
        Field::new("piece", DataType::Utf8, false),
        Field::new("record", DataType::Utf8, false),
    ])
}

impl ScalarUDFImpl for MakePiece {
    fn name(&self) -> &str {
        NAME
    }

    fn signature(&self) -> &Signature {
        &self.signature
    }

    fn return_type(&self, _: &[DataType]) -> Result<DataType> {
        Ok(DataType::Struct(fields()))
    }

    fn invoke_with_args(&self, args: ScalarFunctionArgs) -> Result<ColumnarValue> {
        let columns = ColumnarValue::values_to_arrays(&args.args)?;
        let [plans, pieces] = columns.as_slice() else {
            return exec_err!("{NAME} takes a plan and a piece");
        };
        let (plans, pieces) = (plans.as_string::<i32>(), pieces.as_string::<i32>());
        // An error of a piece is a row, because an error of the query would end the whole job.
        let records: Vec<String> = (0..pieces.len())
            .map(|row| {
                made(
                    Path::new(plans.value(row)),
                    pieces.value(row),
                    &self.isolation,
                )
            })
            .collect();
        let columns: Vec<ArrayRef> = vec![
            Arc::new(pieces.clone()),
            Arc::new(StringArray::from(records)),
        ];
        let made = StructArray::try_new(fields(), columns, None)?;
        Ok(ColumnarValue::Array(Arc::new(made)))
    }
}

/// Makes a piece and returns its record as JSON.
fn made(plan: &Path, piece: &str, isolation: &Isolation) -> String {
    log::info!("piece {piece} begins");
    let record = match (worker(plan), isolation) {
        (Ok(worker), Isolation::None) => worker.make(piece),
        (Ok(worker), Isolation::Child(stance)) => in_child(stance, &worker, piece),
        // The plan cannot be opened here: this executor cannot make any of its pieces.
        (Err(reason), _) => Record {
            piece: piece.to_owned(),
            number: 0,
            name: String::new(),
            outcome: Outcome::Failed,
            files: Vec::new(),
            code: Some("E-PLAN".to_owned()),
            reason: Some(reason),
            secs: 0.0,
        },
    };
    log::info!(
        "piece {piece} ends as {:?} after {:.3} s",
        record.outcome,
        record.secs
    );
    serde_json::to_string(&record).expect("a record is numbers and texts")
}

/// The worker of a plan. Pieces of one plan share the worker, because opening it reads their common inputs.
fn worker(plan: &Path) -> std::result::Result<Arc<Worker>, String> {
    static OPENED: Mutex<Option<(PathBuf, Arc<Worker>)>> = Mutex::new(None);
    let mut opened = OPENED.lock().unwrap_or_else(PoisonError::into_inner);
    if let Some((path, worker)) = opened.as_ref()
        && path == plan
    {
        return Ok(Arc::clone(worker));
    }
    let worker = Arc::new(Worker::open(plan, jobs()).map_err(|error| error.to_string())?);
    *opened = Some((plan.to_owned(), Arc::clone(&worker)));
    Ok(worker)
}

/// Makes a piece in a child process. If the child ends without a record, the piece has failed.
fn in_child(stance: &Path, worker: &Worker, piece: &str) -> Record {
    let begun = Instant::now();
    let output = Command::new(stance)
        .args(["--json", "--no-progress", "stage", "work"])
        .arg(worker.plan().path())
        .args(["--items", piece])
        .output();
    let why = match output {
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stdout);
            if let Some(record) = text
                .lines()
                .find_map(|line| serde_json::from_str(line).ok())
            {
                return record;
            }
            let told = String::from_utf8_lossy(&output.stderr);
            let told = told.lines().last().unwrap_or("it said nothing");
            Failed::new(
                "E-CRASH",
                format!(
                    "the process that made it ended with {}: {told}",
                    output.status
                ),
            )
        }
        Err(error) => Failed::new(
            "E-IO",
            format!("cannot start {}: {error}", stance.display()),
        ),
    };
    match worker.plan().piece(piece) {
        Some(known) => worker.fail(known, why, begun.elapsed().as_secs_f64()),
        None => worker.make(piece),
    }
}
