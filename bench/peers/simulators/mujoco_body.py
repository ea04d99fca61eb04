"""A free body in MuJoCo, with thrust along its z axis and a torque about each axis, integrated by RK4."""

import mujoco

# The actuators act through a site that turns with the body.
MODEL = """
<mujoco>
  <size nuserdata="{user_numbers}"/>
  <option integrator="RK4" timestep="{step_s!r}" gravity="0 0 -{gravity_m_s2!r}">
    <flag contact="disable" constraint="disable"/>
  </option>
  <worldbody>
    <body>
      <freejoint/>
      <inertial pos="0 0 0" mass="{mass_kg!r}" diaginertia="{inertia}"/>
      <site name="body"/>
    </body>
  </worldbody>
  <actuator>
    <motor site="body" gear="0 0 1 0 0 0"/>
    <motor site="body" gear="0 0 0 1 0 0"/>
    <motor site="body" gear="0 0 0 0 1 0"/>
    <motor site="body" gear="0 0 0 0 0 1"/>
  </actuator>
</mujoco>
"""


def free_body(step_s, mass_kg, inertia_kg_m2, gravity_m_s2, user_numbers=0):
    inertia = " ".join(repr(value) for value in inertia_kg_m2)
    return mujoco.MjModel.from_xml_string(
        MODEL.format(step_s=step_s, mass_kg=mass_kg, inertia=inertia, gravity_m_s2=gravity_m_s2,
                     user_numbers=user_numbers))
