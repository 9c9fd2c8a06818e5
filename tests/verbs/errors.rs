//! The errors of a bad pipeline.toml.

use super::common::{marf, photos};
use super::{assert_transcript, with_pipeline};

const HEAD: &str = "[archive.demo]\nkind = \"demo\"\n\n[node.extract]\narchive = \"demo\"\n\n";

/// One test a fault: what follows the archive and its node, and the snapshot of `marf plan`.
macro_rules! refused {
    ($($name:ident: $text:expr;)*) => { $(
        #[test]
        fn $name() {
            let dir = with_pipeline(&format!("{HEAD}{}", $text));
            assert_transcript!(dir.path(), &[&["plan"]]);
        }
    )* };
}

refused! {
    error_unknown_key: "[node.size]\ninput = \"extract\"\nmin_byte = 3\n";
    error_unknown_key_of_the_file: "[nodes.size]\n";
    error_unknown_key_far_from_all: "[node.size]\ninput = \"extract\"\nzzzzzzzz = 3\n";
    error_unknown_stage: "[node.blurr]\ninput = \"extract\"\n";
    error_unknown_stage_of_uses: "[node.sharp]\nuses = \"sharpness\"\ninput = \"extract\"\n";
    error_unknown_node: "[node.size]\ninput = \"extrat\"\n";
    error_cycle: "[node.size]\ninput = \"blur\"\n[node.shape]\ninput = \"size\"\n[node.blur]\ninput = \"shape\"\n";
    error_missing_input: "[node.size]\nmin_bytes = 3\n";
    error_input_of_another_kind: "[node.train]\ninput = \"extract\"\n";
    error_wrong_type: "[node.size]\ninput = \"extract\"\nmin_bytes = \"many\"\n";
    error_out_of_range: "[node.calibrate]\ninput = \"extract\"\n[node.tune]\ninput = \"calibrate\"\ntrials = 0\n";
    error_unknown_variant: "[node.calibrate]\ninput = \"extract\"\nmethod = \"magic\"\n";
    error_bad_budget: "[node.calibrate]\ninput = \"extract\"\n[node.train]\ninput = \"calibrate\"\nbudget = \"soon\"\n";
    error_unknown_archive: "[node.more]\nuses = \"extract\"\narchive = \"demmo\"\n";
    error_unknown_kind_of_archive: "[archive.tape]\nkind = \"tape\"\n[node.more]\nuses = \"extract\"\narchive = \"tape\"\n";
    error_unknown_key_of_an_archive: "[archive.two]\nkind = \"demo\"\nsoles = \"1\"\n[node.more]\nuses = \"extract\"\narchive = \"two\"\n";
    error_not_a_table: "[archive]\ntwo = 3\n";
    error_bad_toml: "[node.size\ninput = 3\n";
    error_kept_and_rejected: "[node.size]\ninput = \"extract\"\n[keep]\nids = [\"a\"]\n[reject]\nids = [\"a\"]\n";
    error_no_shared_store: "[node.size]\ninput = \"extract\"\n[store]\nremote = \"https://key:secret@mars/results\"\n";
    error_unknown_key_of_the_store: "[node.size]\ninput = \"extract\"\n[store]\nremot = \"s3://mars\"\n";
    error_lists_without_a_filter: "[keep]\nids = [\"a\"]\n";
}

#[test]
fn error_of_an_argument() {
    let dir = with_pipeline(&format!("{HEAD}[node.size]\ninput = \"extract\"\n"));
    assert_transcript!(
        dir.path(),
        &[
            &["plan", "--set", "size.min_byte=3"],
            &["plan", "--set", "size"],
            &["plan", "--set", "size.min_bytes.a=3"],
            &["plan", "--to", "blur"],
            &["plna"],
        ]
    );
}

/// A word that is nearly one of a list, in the file, in an argument and on the command line.
#[test]
fn a_word_that_is_nearly_right_has_the_right_one_as_a_hint() {
    let pipeline = |method: &str| {
        format!(
            "{HEAD}[node.calibrate]\ninput = \"extract\"\nmethod = \"{method}\"\n[node.train]\ninput = \"calibrate\"\n[node.bootstrap]\ninput = \"calibrate\"\n"
        )
    };
    let dir = with_pipeline(&pipeline("lables"));
    let said = marf(dir.path(), &["plan"]).exits(2).stderr;
    assert!(said.contains("hint: did you mean `labels`?"), "{said}");
    let dir = with_pipeline(&pipeline("labels"));
    for (args, word) in [
        ("plan --set calibrate.method=\"imprt\"", "import"),
        ("plan --set train.quality=\"drfat\"", "draft"),
        ("plan --set train.device=\"gpi\"", "gpu"),
        ("plan --set bootstrap.viewpoints=\"heldot\"", "heldout"),
        ("plan --set bootstrap.viewpoints=[\"train\",\"orbti\"]", "orbit"),
        ("plan --device cpi", "cpu"),
        ("export mesh --out a.ply --color phtos", "photos"),
        ("render --out a --path flythruogh", "flythrough"),
        ("render --out a --output depht", "depth"),
        ("compare --sols 1 --sols 2 --out a --quality standrad", "standard"),
        ("calibrate photos --method lables", "labels"),
        ("fit photos --fit fixd", "fixed"),
    ] {
        let said = marf(dir.path(), &args.split(' ').collect::<Vec<_>>())
            .exits(2)
            .stderr;
        let hints = [
            format!("did you mean `{word}`?"),
            format!("a similar value exists: '{word}'"),
        ];
        assert!(hints.iter().any(|hint| said.contains(hint)), "{args}: {said}");
    }
}

#[test]
fn error_without_a_pipeline() {
    let dir = tempfile::tempdir().unwrap();
    assert_transcript!(dir.path(), &[&["plan"], &["plan", "--file", "other.toml"]]);
}

#[test]
fn a_memory_that_cannot_do_is_refused_with_the_one_that_can() {
    let dir = photos();
    let fit = "fit photos --budget 1s --memory 90MB --set train.field.log2_table=10 --set train.field.density_width=16 \
               --set train.field.color_width=16 --set train.field.batch_samples=1024 --set train.field.cone=0.2";
    let ran = marf(dir.path(), &fit.split(' ').collect::<Vec<_>>()).exits(1);
    for part in [
        "training on 3 photos needs",
        "`memory` is 90MB",
        "hint: set `memory = \"",
    ] {
        assert!(ran.stderr.contains(part), "`{part}` is not in\n{}", ran.stderr);
    }
    let ran = marf(dir.path(), &["fit", "photos", "--memory", "lots"]).exits(2);
    assert!(
        ran.stderr
            .contains("`lots` is not an amount of memory: write `2GB`"),
        "{}",
        ran.stderr
    );
}
