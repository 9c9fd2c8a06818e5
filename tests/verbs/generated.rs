//! What is generated from the command line: manual pages and completions.

use crate::common::marf;

#[test]
fn every_verb_has_a_manual_page_with_its_options() {
    let dir = tempfile::tempdir().unwrap();
    marf(dir.path(), &["man", "pages"]).exits(0);
    let page = |name: &str| std::fs::read_to_string(dir.path().join("pages").join(name)).unwrap();
    assert!(page("marf.1").contains(".TH marf 1"), "{}", page("marf.1"));
    let render = page("marf-render.1");
    // Hyphens are written as \\- in roff.
    assert!(
        render.contains("\\-\\-path") && render.contains("bookmarks"),
        "{render}"
    );
    assert!(page("marf-export-mesh.1").contains("glb"));
    let again = std::fs::read(dir.path().join("pages/marf.1")).unwrap();
    marf(dir.path(), &["man", "pages"]).exits(0);
    assert_eq!(
        std::fs::read(dir.path().join("pages/marf.1")).unwrap(),
        again,
        "no date, no path"
    );
}

#[test]
fn completions_of_every_shell_know_the_verbs() {
    let dir = tempfile::tempdir().unwrap();
    for shell in ["bash", "elvish", "fish", "powershell", "zsh"] {
        let said = marf(dir.path(), &["completions", shell]).exits(0);
        assert!(
            said.stdout.contains("render") && said.stdout.contains("quantizer"),
            "{shell}"
        );
    }
    marf(dir.path(), &["completions", "tcsh"]).exits(2);
}
