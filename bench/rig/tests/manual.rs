//! Completions, as bash uses them, and manual pages, as groff formats them.

use std::fs;
use std::process::Command;

use crate::rig::{Ended, IRONBIRD, Rig, lacks_tool};

fn ironbird(rig: &Rig, args: &str) -> Ended {
    let mut command = Command::new(IRONBIRD);
    command
        .args(args.split(' '))
        .env("IRONBIRD_ROOT", rig.root());
    rig.launch(command).end().expect(0)
}

#[test]
fn shells_complete_commands_flags_and_values() {
    let rig = Rig::new("shells");
    for (shell, words) in [
        ("zsh", "#compdef ironbird"),
        ("fish", "complete -c ironbird"),
    ] {
        ironbird(&rig, &format!("completions {shell}"))
            .says(words)
            .says("around-misses");
    }
    if Command::new("bash").arg("--version").output().is_err() {
        return lacks_tool("completions of bash: it is not installed");
    }
    let script = rig.file("completions.bash");
    fs::write(&script, ironbird(&rig, "completions bash").stdout).unwrap();
    // `r` is not completed to the hidden command `ring-hop`.
    for (words, completed) in [
        ("ironbird f", "fly faults floor"),
        ("ironbird fly --log a", "all around-misses"),
        ("ironbird runs --ol", "--older-than"),
        ("ironbird r", "record replay report runs"),
    ] {
        let last = words.split(' ').count() - 1;
        let mut bash = Command::new("bash");
        bash.arg("-c").arg(format!(
            "source {script}; complete -p ironbird; COMP_WORDS=({words}); COMP_CWORD={last}; \
             _ironbird ironbird \"${{COMP_WORDS[{last}]}}\" \"${{COMP_WORDS[{last}-1]}}\"; echo \"${{COMPREPLY[@]}}\""
        ));
        let text = rig.launch(bash).end().expect(0).says("complete ").stdout;
        let mut found: Vec<&str> = text.lines().last().unwrap().split(' ').collect();
        if words == "ironbird r" {
            found.sort_unstable();
        }
        assert_eq!(found.join(" "), completed);
    }
}

#[test]
fn manual_pages_are_formatted_without_a_complaint() {
    let rig = Rig::new("man");
    let pages = rig.path("pages");
    ironbird(&rig, &format!("man --to {}", pages.display()));
    for (page, exists) in [
        ("ironbird", true),
        ("ironbird-fly", true),
        ("ironbird-runs", true),
        ("ironbird-report-diff", true),
        ("ironbird-ring-hop", false),
    ] {
        assert_eq!(pages.join(format!("{page}.1")).is_file(), exists, "{page}");
    }
    let page = |name: &str| fs::read_to_string(pages.join(name)).unwrap();
    assert_eq!(ironbird(&rig, "man").stdout, page("ironbird.1"));
    ironbird(&rig, "man report diff").says("\\fBironbird report diff\\fR");
    ironbird(&rig, "man fly")
        .says(".TH ironbird-fly 1")
        .says("around\\-misses");
    if Command::new("groff").arg("--version").output().is_err() {
        return lacks_tool("manual pages: groff is not installed");
    }
    let mut groff = Command::new("groff");
    let flags = ["-man", "-Tutf8", "-ww", "-z"];
    groff.args(flags).arg(pages.join("ironbird-fly.1"));
    assert_eq!(rig.launch(groff).end().expect(0).stderr, "");
}
