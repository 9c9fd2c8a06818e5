//! Fixed entities of every graph: the descriptor, the crate itself, its profiles and its licence, the
//! program.

use serde_json::{Value, json};

use super::actions::{action_id, item_id};
use super::context::Context;
use super::entity::{Entity, FORMAL_PARAMETER, LANGUAGE, PROGRAM};
use super::input::{CRATE_FORMAT, CRATE_PROFILE, METADATA, root_name};
use crate::contents::OBJECTS;
use crate::time::{end_of, known_time};

const RO_CRATE: &str = "https://w3id.org/ro/crate/1.1";
const WORKFLOW_RO_CRATE: &str = "https://w3id.org/workflowhub/workflow-ro-crate/1.0";
const RUN_PROFILES: [(&str, &str); 3] = [
    ("https://w3id.org/ro/wfrun/process/0.5", "Process Run Crate"),
    ("https://w3id.org/ro/wfrun/workflow/0.5", "Workflow Run Crate"),
    ("https://w3id.org/ro/wfrun/provenance/0.5", "Provenance Run Crate"),
];
const LICENSE: &str = "#license";

pub(super) fn entities(context: &Context<'_>) -> Vec<Value> {
    let mut entities = vec![descriptor(), root(context)];
    entities.extend(profiles());
    entities.push(license(context.input.license));
    entities.extend([program(context), language()]);
    if !context.input.contents.objects.is_empty() {
        entities.push(objects());
    }
    entities
}

fn descriptor() -> Value {
    Entity::new(METADATA, "CreativeWork")
        .with_ids("conformsTo", [RO_CRATE, WORKFLOW_RO_CRATE])
        .with_ids("about", ["./"])
        .into_value()
}

fn root(context: &Context<'_>) -> Value {
    let run = context.record();
    let own_profile = format!("{CRATE_PROFILE}{CRATE_FORMAT}");
    let profiles = RUN_PROFILES.iter().map(|(id, _)| *id);
    let files = context.input.files.iter().map(|described| described.id.as_str());
    let objects = (!context.input.contents.objects.is_empty()).then_some(OBJECTS);
    let actions = run.nodes.iter().map(|node| action_id(&node.name));
    let items = context.input.contents.items.iter();
    let items = items.map(item_id);
    let ended = end_of(run.started_unix_s, run.seconds);
    Entity::new("./", "Dataset")
        .with("name", format!("marf run {} of {}", run.id, run.pipeline))
        .with(
            "description",
            format!(
                "One run of the pipeline `{}`: what ran, on what, with which parameters, and what came out. Every file has \
                 its SHA-256 and blake3 digest; every action is named by the blake3 digest of its file in actions/.",
                run.pipeline
            ),
        )
        .with("datePublished", known_time(ended))
        .with("identifier", root_name(run))
        .with_ids("license", [license_id(context.input.license)])
        .with_ids("mainEntity", [context.pipeline()])
        .with_ids(
            "conformsTo",
            profiles.chain([WORKFLOW_RO_CRATE, own_profile.as_str()]),
        )
        .with_ids("hasPart", files.chain(objects))
        .with_ids(
            "mentions",
            ["#run".to_owned(), "#marf/run".to_owned()]
                .into_iter()
                .chain(actions)
                .chain(items),
        )
        .into_value()
}

fn profiles() -> Vec<Value> {
    let profile = |id: &str, name: &str, version: String| {
        Entity::new(id, "CreativeWork")
            .with("name", name)
            .with("version", version)
            .into_value()
    };
    let runs = RUN_PROFILES
        .iter()
        .map(|(id, name)| profile(id, name, "0.5".to_owned()));
    let mut profiles: Vec<Value> = runs.collect();
    profiles.push(profile(RO_CRATE, "RO-Crate", "1.1".to_owned()));
    profiles.push(profile(WORKFLOW_RO_CRATE, "Workflow RO-Crate", "1.0".to_owned()));
    profiles.push(profile(
        &format!("{CRATE_PROFILE}{CRATE_FORMAT}"),
        "marf crate",
        CRATE_FORMAT.to_string(),
    ));
    profiles.push(profile(
        FORMAL_PARAMETER,
        "Bioschemas FormalParameter",
        "1.0-RELEASE".to_owned(),
    ));
    profiles
}

/// Returns the id of a licence: its URL, that of SPDX for a short name, or that of the sentence that none was stated.
fn license_id(license: Option<&str>) -> String {
    match license {
        None => LICENSE.to_owned(),
        Some(url) if url.contains("://") => url.to_owned(),
        Some(name) => format!("https://spdx.org/licenses/{name}"),
    }
}

fn license(license: Option<&str>) -> Value {
    let entity = Entity::new(license_id(license), "CreativeWork");
    match license {
        Some(name) => entity.with("name", name),
        None => entity.with("name", "No licence was stated").with(
            "description",
            "Whoever exported this crate stated no licence. The photos have the terms of the archive they came from.",
        ),
    }
    .into_value()
}

fn program(context: &Context<'_>) -> Value {
    let entity = Entity::new(PROGRAM, "SoftwareApplication")
        .with("name", "marf")
        .with(
            "description",
            "Plans and runs the pipeline: raw rover photos to radiance fields.",
        );
    let program = context.record().program.as_str();
    match &context.record().build {
        None => entity.with("softwareVersion", program),
        Some(build) => entity
            .with(
                "softwareVersion",
                format!(
                    "{program}, commit {}",
                    build.commit.as_deref().unwrap_or("unknown")
                ),
            )
            .with("identifier", format!("blake3:{}", build.blake3))
            .with("fileSize", build.bytes.to_string())
            .with("operatingSystem", build.os.as_str())
            .with("processorRequirements", build.arch.as_str()),
    }
    .into_value()
}

fn language() -> Value {
    Entity::new(LANGUAGE, "ComputerLanguage")
        .with("name", "marf pipeline (TOML)")
        .with("alternateName", "pipeline.toml")
        .into_value()
}

fn objects() -> Value {
    Entity::new(OBJECTS, "Dataset")
        .with("name", "Objects")
        .with(
            "description",
            json!(
                "Blocks and leaves of sets of photos and verdicts, and the photos' bytes. Each file is named by the blake3 \
                 digest of its bytes; the manifest of the bag has its SHA-256."
            ),
        )
        .into_value()
}
