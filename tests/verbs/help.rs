use super::assert_transcript;

/// One test a verb: the snapshot of its `--help`.
macro_rules! help_of {
    ($($name:ident: $($word:literal),+;)*) => { $(
        #[test]
        fn $name() {
            assert_transcript!(std::path::Path::new("."), &[&[$($word),+]]);
        }
    )* };
}

help_of! {
    help: "--help";
    help_run: "run", "--help";
    help_plan: "plan", "--help";
    help_why: "why", "--help";
    help_exec: "exec", "--help";
    help_status: "status", "--help";
    help_log: "log", "--help";
    help_archive: "archive", "--help";
    help_archive_check: "archive", "check", "--help";
    help_init: "init", "--help";
    help_schema: "schema", "--help";
    help_report: "report", "--help";
    help_view: "view", "--help";
    help_render: "render", "--help";
    help_compare: "compare", "--help";
    help_export: "export", "--help";
    help_export_crate: "export", "crate", "--help";
    help_export_attest: "export", "attest", "--help";
    help_export_cameras: "export", "cameras", "--help";
    help_export_mesh: "export", "mesh", "--help";
    help_export_splats: "export", "splats", "--help";
    help_verify: "verify", "--help";
    help_audit: "audit", "--help";
    help_replay: "replay", "--help";
    help_diff: "diff", "--help";
    help_cache: "cache", "--help";
    help_cache_stat: "cache", "stat", "--help";
    help_cache_gc: "cache", "gc", "--help";
    help_cache_fsck: "cache", "fsck", "--help";
    help_cache_push: "cache", "push", "--help";
    help_cache_pull: "cache", "pull", "--help";
    help_cache_pin: "cache", "pin", "--help";
    help_cache_unpin: "cache", "unpin", "--help";
    help_filter: "filter", "--help";
    help_photos: "photos", "--help";
    help_calibrate: "calibrate", "--help";
    help_fit: "fit", "--help";
    help_trade: "trade", "--help";
    help_man: "man", "--help";
    help_completions: "completions", "--help";
}
