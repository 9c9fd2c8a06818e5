use marf_engine::Cancel;

use super::args::{CalibrateArgs, Global, Method};
use super::error::CliError;
use super::filter::folder;
use super::run::{execute, options};
use super::session::Session;
use super::{export, say_json};

/// `marf calibrate DIR`: writes transforms.json, and metrics.json beside it.
pub fn calibrate(global: &Global, args: &CalibrateArgs, cancel: &Cancel) -> Result<(), CliError> {
    let session = Session::implicit(&pipeline(args), global)?;
    let (record, ended) = execute(&session, &options(global, &session.name), global, cancel)?;
    ended?;
    let node = record.nodes.iter().find(|node| node.name == "calibrate");
    let output = |name: &str| {
        let output = node.and_then(|node| node.outputs.get(name));
        output.ok_or_else(|| CliError::failed(format!("calibrate gave no `{name}`")))
    };
    let metrics = output("metrics")?;
    export::one(&session, &output("transforms")?.digest, &args.out)?;
    export::one(
        &session,
        &metrics.digest,
        &args.out.with_file_name("metrics.json"),
    )?;
    let json: serde_json::Value = serde_json::from_slice(&session.store.get(&metrics.digest)?)
        .map_err(|error| CliError::failed(format!("metrics: {error}")))?;
    if global.json {
        return say_json(&json);
    }
    crate::talk(&format!("wrote {}", args.out.display()));
    Ok(())
}

fn pipeline(args: &CalibrateArgs) -> String {
    let method = match args.method {
        Method::Sfm => "sfm",
        Method::Labels => "labels",
        Method::Import => "import",
    };
    let cameras = "cameras = \"extract\"\n";
    format!(
        "name = \"calibrate\"\n{}[node.calibrate]\ninput = \"extract\"\n{cameras}method = \"{method}\"\n",
        folder(&args.dir)
    )
}
