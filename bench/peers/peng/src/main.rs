//! peng_quad flies the common work: `peng WORK.json STEPS_PER_TICK` prints its end state and time as JSON.

use std::error::Error;
use std::hint::black_box;
use std::time::Instant;

use nalgebra::Vector3;
use peng_quad::Quadrotor;
use serde_json::{Value, json};

/// Thrust [N] and torque [N m] of a tick, in the single precision that peng_quad computes in.
type Command = (f32, Vector3<f32>);

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().collect();
    let [_, path, steps] = args.as_slice() else {
        return Err("usage: peng WORK.json STEPS_PER_TICK".into());
    };
    let steps: usize = steps.parse()?;
    let work: Value = serde_json::from_slice(&std::fs::read(path)?)?;
    let commands: Vec<Command> = list(&work["commands"])?
        .iter()
        .map(|tick| {
            let [t_x, t_y, t_z] = [0, 1, 2].map(|i| number(&tick["torque_b_nm"][i]));
            Ok((number(&tick["thrust_n"])?, Vector3::new(t_x?, t_y?, t_z?)))
        })
        .collect::<Result<_, Box<dyn Error>>>()?;

    let warm = &commands[..commands.len().min(1000)];
    black_box(fly(&mut start(&work, steps)?, warm, steps));
    let mut quadrotor = start(&work, steps)?;
    let begin = Instant::now();
    fly(&mut quadrotor, black_box(&commands), steps);
    let wall_s = begin.elapsed().as_secs_f64();

    let position: Vec<f32> = quadrotor.position.iter().copied().collect();
    let quaternion: Vec<f32> = quadrotor.orientation.coords.iter().copied().collect();
    println!("{}", json!({ "wall_s": wall_s, "position_w_m": position, "quaternion_wb_xyzw": quaternion }));
    Ok(())
}

/// A quadrotor at rest in the origin, without drag.
fn start(work: &Value, steps: usize) -> Result<Quadrotor, Box<dyn Error>> {
    let step_s = number(&work["period_s"])? / steps as f32;
    let [x, y, z] = [0, 1, 2].map(|i| number(&work["inertia_kg_m2"][i]));
    let inertia = [x?, 0.0, 0.0, 0.0, y?, 0.0, 0.0, 0.0, z?];
    let quadrotor = Quadrotor::new(step_s, number(&work["mass_kg"])?, number(&work["gravity_m_s2"])?, 0.0, inertia);
    Ok(quadrotor.map_err(|e| e.to_string())?)
}

fn fly(quadrotor: &mut Quadrotor, commands: &[Command], steps: usize) {
    for (thrust, torque) in commands {
        for _ in 0..steps {
            quadrotor.update_dynamics_with_controls_rk4(*thrust, torque);
        }
    }
}

fn list(value: &Value) -> Result<&Vec<Value>, Box<dyn Error>> {
    value.as_array().ok_or_else(|| format!("{value} is not a list").into())
}

fn number(value: &Value) -> Result<f32, Box<dyn Error>> {
    Ok(value.as_f64().ok_or_else(|| format!("{value} is not a number"))? as f32)
}
