//! A swap is refused where it is out of the range of the airframe that flies, and changes nothing then.

use messages::parameters::{Airframe, Parameter, ParameterError};
use plant::{Plant, PlantSettings, Swap, SwapError};

#[test]
fn a_small_airframe_takes_small_values_alone() {
    let mut values = *Airframe::nominal().values();
    values[Parameter::Mass as usize] = 0.027;
    let airframe = Airframe::built_with(values).unwrap();
    let mut plant = Plant::new(&PlantSettings {
        airframe,
        ..PlantSettings::default()
    });
    let mass = |value| Swap::new(0, &[(Parameter::Mass, value)]).unwrap();
    let refused = plant.schedule(mass(0.52)).unwrap_err();
    assert!(matches!(
        refused,
        SwapError::Value(ParameterError::OutOfRange {
            parameter: Parameter::Mass,
            ..
        })
    ));
    plant.schedule(mass(0.03)).unwrap();
    plant.begin(0);
    assert_eq!((plant.airframe().m(), plant.parameter_epoch()), (0.03, 1));
    assert_eq!(plant.airframe().as_built(), airframe);
}
