# SPDX-License-Identifier: Apache-2.0
"""Definition of ContactState in recordings made before ContactStates: a topic with one message per contact point."""

DEFINITION = """\
std_msgs/Header header
string contact_point
geometry_msgs/Vector3 direction
float64 speed
float64 effective_mass
float64 lumped_mass
float64 full_mass
float64 iso_mass
float64 worst_direction_mass
float64 obstacle_mass
float64 reduced_mass
float64 stiffness
float64 predicted_force
float64 allowable_speed
float64 margin
string body_region
string criterion
uint8 verdict
string reason
float64 input_age
bool worst_direction_used
bool mass_capped
float64 smallest_singular_value
bool watchdog
float64 worst_normal_reduced_mass
float64 force_bound
float64 clamping_force
float64[6] lumped_mobility
float64[6] full_mobility
string contact_normal
string mass_model
string mass_model_reason
geometry_msgs/Vector3 test_direction
float64 test_effective_mass
float64 velocity_delay
"""
