use control_api::Rig;
use control_api::description::Settings;
use control_api::law::{InnerLaw, Law};
use firmware::bridge::Bridge;
use std::time::*;
fn main() {
    for i in 0..std::env::args().nth(1).unwrap().parse().unwrap() {
        let t = Instant::now();
        let mut b = Bridge::new(&Rig::default(), &Settings::default()).unwrap();
        let r = b.start(i % 2 == 0);
        print!("{i} {:?} {:?}", r, t.elapsed());
        std::thread::sleep(Duration::from_millis(1500));
        let mut tel = Default::default();
        let mut o = vec![];
        for tick in 0..400u64 {
            let mut inp = control_api::law::InnerInput {
                tick,
                measured_age: 0,
                wanted_age: 0,
                given_age: 0,
                measured: Default::default(),
                wanted: Default::default(),
                reference: Default::default(),
                given: Default::default(),
            };
            inp.measured.specific_force_b_m_s2 = [0., 0., 9.8];
            inp.wanted.thrust_n = 2.0;
            b.tick(&inp, &mut tel);
            if i % 2 == 0 {
                std::thread::sleep(Duration::from_micros(800));
            }
            if tick % 130 == 0 {
                o.push(format!("{} {:.2}", tel.value[0], tel.value[6]));
            }
        }
        println!(" {o:?}");
    }
}
