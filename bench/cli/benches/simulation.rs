//! How fast the four laws fly in one process, the theorem's monitor beside them: ticks per second, on one core.
//!
//! A thousand ticks per second are real time at 1 kHz, so `thrpt` in Kelem/s is the factor over real time.

use config::Settings;
use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use sim::simulator::Simulator;

const TICKS: u64 = 20_000;

fn simulate(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("simulate 20 s");
    group
        .throughput(Throughput::Elements(TICKS))
        .sample_size(20);
    for preset in ["flight", "paper"] {
        let overrides = vec![("flight.preset", toml::Value::from(preset))];
        let settings =
            Settings::resolve(None, &overrides).unwrap_or_else(|failure| panic!("{failure}"));
        let watched =
            || Simulator::of(&settings).and_then(|rig| Ok(rig.with_monitor(settings.theorem()?)));
        group.bench_function(preset, |bencher| {
            bencher.iter_batched_ref(
                || watched().unwrap_or_else(|failure| panic!("{failure}")),
                |rig| {
                    for _ in 0..TICKS {
                        std::hint::black_box(&mut *rig).tick();
                    }
                },
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
}

criterion_group!(benches, simulate);
criterion_main!(benches);
