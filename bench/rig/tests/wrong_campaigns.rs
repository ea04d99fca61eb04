//! What is wrong with a campaign's file is told, with its line, and nothing is begun.
#![allow(clippy::unwrap_used, reason = "in a test, a panic is the verdict")]

use crate::rig::Rig;

#[test]
fn every_mistake_is_named_with_its_line() {
    let rig = Rig::new("mistakes");
    let head = "[campaign]\nname = \"x\"\nflights = 10\n";
    for (text, said) in [
        ("flights = 3", "line 1: there is no section [campaign]"),
        (
            "[campaign]\nname = \"x\"\nflihgts = 10",
            "line 3: unknown key `flihgts` in [campaign], which has name, flights, seed, chunk, timing; did you mean `flights`?",
        ),
        ("[campaign]\nname = \"x\"\nflights = 0", "line 3: campaign.flights = 0: expected a whole number from 1 to"),
        ("[campaign]\nname = \"a b\"\nflights = 1", "line 2: campaign.name must be 1 to 64 letters"),
        (
            "[campaign]\nname = \"x\"\nflights = 1\n[arms.\"../away\"]\n\"inner.law\" = \"fixed\"",
            "line 4: an arm is named by 1 to 64 letters, digits, - or _, and not `../away`",
        ),
        ("[campaign]\nname = \"x\"\nflights = 10\nname = \"x\"", "line 4: duplicate key"),
        (
            &format!("{head}[factors]\n\"plant.mass_kg\" = {{ uniform = [0.6, 0.4] }}"),
            "line 5: uniform = [0.6, 0.4]: the range is empty",
        ),
        (
            &format!("{head}[factors]\n\"plant.mass_kg\" = {{ unifrom = [0.4, 0.6] }}"),
            "line 5: `unifrom` is no way to draw",
        ),
        (&format!("{head}[factors]\n\"plant.mass_kg\" = {{ loguniform = [0, 0.6] }}"), "both ends must be above 0"),
        (
            &format!("{head}[factors]\n\"plant.mass_kg\" = {{ normal = [0.5, 0.0] }}"),
            "line 5: normal = [0.5, 0.0]: expected [mean",
        ),
        (&format!("{head}[factors]\n\"plant.mass_kg\" = {{ normal = [0.5, 0.1] }}"), "plant.mass_kg = -0.35"),
        (
            &format!("{head}[factors]\n\"plant.mass_kg\" = {{ normal = [0.5, 0.01], within = [1.0, 2.0] }}"),
            "fewer than one draw in a hundred",
        ),
        (&format!("{head}[factors]\n\"plant.mass_kg\" = {{ choice = [] }}"), "line 5: choice = []: expected a list"),
        (
            &format!(
                "{head}[factors]\n\"plant.mass_kg\" = {{ grid = [0.1, 0.2, 0.3, 0.4] }}\n\"flight.seed\" = {{ grid = [1, 2, 3] }}"
            ),
            "line 3: the grids have 12 cells, and 10 flights leave some of them out",
        ),
        (&format!("{head}[factors]\nmass = {{ uniform = [0.4, 0.6] }}"), "line 5: `mass` is no key of the settings"),
        (
            &format!("{head}[factors]\n\"plant.mas_kg\" = {{ uniform = [0.4, 0.6] }}"),
            "unknown key `plant.mas_kg`; did you mean `mass_kg`?|: line 5",
        ),
        (
            &format!("{head}[factors]\n\"plant.mass_kg\" = {{ uniform = [0.4, 5.5] }}"),
            "plant.mass_kg = 5.5 is out of range: allowed are 0.05 to 5.0 kg|: line 5",
        ),
        (&format!("{head}[plant]\nmass_kg = 0.5\ngarvity = 1.0"), "unknown key `plant.garvity`"),
        (
            &format!("{head}[submit]\npartiton = \"batch\""),
            "line 5: unknown key `partiton` in [submit], which has partition, time_limit_s, requeue, processors; did you \
             mean `partition`?",
        ),
        (
            &format!("{head}[submit]\npartition = \"a b\"\nprocessors = 0"),
            "line 5: submit.partition = \"a b\": expected a partition's name, as in \"batch\"|\
             line 6: submit.processors = 0: expected a whole number from 1 to 4096",
        ),
        (
            &format!("{head}[submit]\ntime_limit_s = 59\nrequeue = \"no\""),
            "line 5: submit.time_limit_s = 59: expected a time from 60 to 1e8 s|\
             line 6: submit.requeue = \"no\": expected true or false",
        ),
        (&format!("{head}[[fault]]\nwhat = \"mass_kg\"\nvalue = 0.6"), "line 4: fault 1 has no `at_s`"),
        (&format!("{head}[[fault]]\nwhat = \"mas_kg\"\nvalue = 0.6\nat_s = 1.0"), "line 5: unknown parameter `mas_kg`"),
        (
            &format!("{head}[[fault]]\nwhat = \"mass_kg\"\nvalue = 0.6\nat_s = {{ uniform = [-1.0, 2.0] }}"),
            "line 7: fault.1.at_s = -1.0: expected a time from 0 s on",
        ),
        (
            &format!("{head}[[fault]]\nwhat = \"mass_kg\"\nvalue = 0.6\nat_s = {{ uniform = [1.0, 31.0] }}"),
            "never strikes: the flight ends at tick 30000|: line 7",
        ),
        (&format!("{head}[arms.one]\n\"inner.lwa\" = \"pid\""), "unknown key `inner.lwa`"),
        (&format!("{head}[arms.one]\n\"inner.law\" = \"pdi\""), "there is no inner law of that name"),
        (
            &format!(
                "{head}[factors]\n\"inner.law\" = {{ choice = [\"pid\", \"indi\"] }}\n[arms.one]\n\"inner.law\" = \"pid\""
            ),
            "line 6: `inner.law` is drawn as a factor, so the arm one cannot set it",
        ),
        (
            &format!("{head}[success]\nposition_error_max = 0.5"),
            "line 5: unknown key `position_error_max` in [success], which has|did you mean `position_error_max_m`?",
        ),
        (
            &format!("{head}[[fault]]\nwhat = \"state.dorp\"\nvalue = 0.1\nat_s = 2.0"),
            "unknown fault `state.dorp`; did you mean `state.drop`?",
        ),
        (&format!("{head}[[fault]]\nwhat = \"state.dorp\"\nvalue = 0.1\nat_s = 2.0"), "line 5, flown by the arm"),
        (
            &format!("{head}[[fault]]\nwhat = \"state.drop\"\nvalue = {{ uniform = [0.5, 1.5] }}\nat_s = 2.0"),
            "`: write a share above 0 and up to 1",
        ),
        (&format!("{head}[[fault]]\nwhat = \"state.drop\"\nat_s = 2.0"), "line 4: fault 1 has no `value`"),
        (
            &format!("{head}[[fault]]\nwhat = \"inner.kill\"\nvalue = 1.0\nat_s = 2.0"),
            "line 6: fault 1 takes no value: leave it out",
        ),
        (
            &format!("{head}[[fault]]\nwhat = \"mass_kg\"\nvalue = 0.6\nat_s = 2.0\nfor_s = 1.0"),
            "mass_kg holds until it is changed again",
        ),
        (&format!("{head}[success]\nrecovery_max_s = 0.5"), "line 5: recovery_max_s is the time after a fault"),
        (
            &format!("{head}[success]\ntilt_max_rad = -1"),
            "line 5: success.tilt_max_rad = -1: expected a number from 0 on",
        ),
        (
            &format!("{head}[success.telemetry]\n\"inner.nothing\" = [0.0, 1.0]"),
            "line 5: no arm has a law of the role inner that shows `nothing`",
        ),
        (&format!("{head}[success.telemetry]\n\"plant.mass\" = 1.0"), "a number of a law is named by its role"),
    ] {
        let file = rig.settings(text);
        for command in ["check", "run"] {
            let refused = rig.run("campaign", &[command, &file]).expect(2).complains(&file);
            said.split('|').fold(refused, |refused, said| refused.complains(said));
        }
    }
    rig.run("campaign", &["check", &rig.file("none.toml")]).expect(2).complains("cannot read the campaign");
    assert!(!rig.path("campaigns").exists(), "nothing was begun");
}
