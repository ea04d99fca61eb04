//! Completions, as bash uses them, and manual pages, as groff sets them.

use std::fs;
use std::process::Command;

use crate::rig::{Ended, IRONBIRD, Rig, lacks_tool};

fn ironbird(rig: &Rig, args: &[&str]) -> Ended {
    let mut command = Command::new(IRONBIRD);
    command.args(args).env("IRONBIRD_ROOT", rig.root());
    rig.launch(command).end()
}

/// What a shell prints of a script; none where there is no such shell.
fn shell(rig: &Rig, shell: &str, script: &str) -> Option<String> {
    if Command::new(shell).arg("-c").arg("true").output().is_err() {
        lacks_tool(&format!("completions of {shell}: it is not installed"));
        return None;
    }
    let mut command = Command::new(shell);
    command.arg("-c").arg(script);
    Some(rig.launch(command).end().expect(0).stdout)
}

#[test]
fn bash_completes_commands_flags_and_values() {
    let rig = Rig::new("bash");
    let script = rig.file("completions.bash");
    fs::write(
        &script,
        ironbird(&rig, &["completions", "bash"]).expect(0).stdout,
    )
    .unwrap();
    let complete = |words: &str| {
        let count = words.split(' ').count() - 1;
        let script = format!(
            "source {script}; complete -p ironbird; COMP_WORDS=({words}); COMP_CWORD={count}; \
             _ironbird ironbird \"${{COMP_WORDS[{count}]}}\" \"${{COMP_WORDS[{count}-1]}}\"; echo \"${{COMPREPLY[@]}}\""
        );
        shell(&rig, "bash", &script)
    };
    let Some(found) = complete("ironbird f") else {
        return;
    };
    assert!(
        found.contains("complete ") && found.lines().last() == Some("fly faults floor"),
        "{found}"
    );
    assert_eq!(
        complete("ironbird fly --log a").unwrap().lines().last(),
        Some("all around-misses")
    );
    assert_eq!(
        complete("ironbird runs --ol").unwrap().lines().last(),
        Some("--older-than")
    );
    let all = complete("ironbird r").unwrap();
    assert!(
        all.contains("runs") && !all.contains("ring-hop"),
        "what is hidden is not completed: {all}"
    );
}

#[test]
fn other_shells_have_completions_too() {
    let rig = Rig::new("shells");
    for (shell, words) in [
        ("zsh", "#compdef ironbird"),
        ("fish", "complete -c ironbird"),
    ] {
        ironbird(&rig, &["completions", shell])
            .expect(0)
            .says(words)
            .says("around-misses");
    }
}

#[test]
fn manual_pages_are_set_without_a_complaint() {
    let rig = Rig::new("man");
    let pages = rig.path("pages");
    ironbird(&rig, &["man", "--to", pages.to_str().unwrap()]).expect(0);
    assert!(
        !pages.join("ironbird-ring-hop.1").exists(),
        "what is hidden has no page"
    );
    for page in [
        "ironbird.1",
        "ironbird-fly.1",
        "ironbird-runs.1",
        "ironbird-report-diff.1",
    ] {
        assert!(pages.join(page).is_file(), "{page}");
    }
    let printed = ironbird(&rig, &["man"]).expect(0);
    assert_eq!(
        printed.stdout,
        fs::read_to_string(pages.join("ironbird.1")).unwrap()
    );
    ironbird(&rig, &["man", "report", "diff"])
        .expect(0)
        .says("\\fBironbird report diff\\fR");
    let fly = ironbird(&rig, &["man", "fly"])
        .expect(0)
        .says(".TH ironbird-fly 1")
        .says("around\\-misses");
    if Command::new("groff").arg("--version").output().is_err() {
        lacks_tool("manual pages: groff is not installed");
        return;
    }
    let page = rig.file("fly.1");
    fs::write(&page, fly.stdout).unwrap();
    let mut groff = Command::new("groff");
    groff.args(["-man", "-Tutf8", "-ww", "-z", &page]);
    assert_eq!(rig.launch(groff).end().expect(0).stderr, "");
}
