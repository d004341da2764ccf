"""Behaviour of the former detector that the contact model does not have: each test fails for a stated reason.

A test that passes again fails the suite until it leaves this table.
"""

from pathlib import Path

import pytest

_HERE = Path(__file__).parent
UNIFORM = (
    "all taxels are loaded alike and slide at once, below the likely friction: the contact model tells no "
    "gross slip from a load that rests"
)
SWINGS = "each swing in which a tenth of the area slips is reported, and a shaking hand never as one slip"
NEAR_LIMIT = "an emulated load near the limit that rests is called gross, or gross slip at the wrong instant"
LATER = "a tenth of the area does not slip yet where shear begins to grow"
CHANNELS = "channels that are stuck, noisy or jump together stay in the contact model"
SLANT = "a press at a slant shows shear like any other"
NO_SHEAR = "the centre of load of an array without shear channels tells no slip"
GAP = "a slip inside a gap is reported as incipient only"

KNOWN = {
    "test_a_load_that_is_taken_off_after_gross_slip_is_no_slip": UNIFORM,
    "test_a_slide_that_turns_back_ends_and_is_another": UNIFORM,
    "test_a_slip_after_the_load_was_taken_off_is_another": UNIFORM,
    "test_gross_slip_is_said_within_50_ms_where_shear_leaves_no_doubt": UNIFORM,
    "test_many_taxels_are_gross_with_and_without_noise": UNIFORM,
    "test_two_slips_50_ms_apart_are_two_where_the_skin_springs_back_in_between": UNIFORM,
    "test_a_creep_of_many_seconds_is_found_before_it_is_gross": UNIFORM,
    "test_a_gap_in_a_slip_ends_it_and_the_end_is_not_valid": UNIFORM,
    "test_a_slide_is_gross_on_arrays_of_any_scale[xyz-two-pads-4x4-balanced]": UNIFORM,
    "test_a_slide_is_gross_on_arrays_of_any_scale[xyz-two-pads-4x4-fast]": UNIFORM,
    "test_channels_that_turn_nan_in_mid_slip_take_their_taxels_along": UNIFORM,
    "test_in_10_mv_of_noise_each_slide_is_reported_and_most_as_one_slip": UNIFORM,
    "test_it_works_at_any_rate": UNIFORM,
    "test_it_works_on_one_taxel_and_on_many": UNIFORM,
    "test_late_scans_make_no_valid_event": UNIFORM,
    "test_noise_that_changes_a_hundredfold_is_no_slip_and_hides_none": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.05-0-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.05-0-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.05-14-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.05-14-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.05-34-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.05-34-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.1-0-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.1-0-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.1-14-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.1-14-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.1-34-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.1-34-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.15-0-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.15-14-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.15-14-8]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.15-34-3]": UNIFORM,
    "test_one_channel_that_is_lost_in_mid_slip_hides_no_gross_slip[4.15-34-8]": UNIFORM,
    "test_the_contact_s_states_are_told_with_the_slip": UNIFORM,
    "test_two_slips_in_quick_succession_are_both_told": UNIFORM,
    "test_a_load_that_sways_below_friction_is_reported_at_most_twice": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[0.5-0.3-balanced]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[0.5-0.3-fast]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[0.5-0.3-quiet]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[1.0-0.6-balanced]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[1.0-0.6-fast]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[1.0-0.6-quiet]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[2.0-0.15-balanced]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[2.0-0.15-fast]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[2.0-0.15-quiet]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[2.0-0.3-balanced]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[2.0-0.3-fast]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[2.0-0.3-quiet]": SWINGS,
    "test_sustained_shaking_is_reported_a_few_times_and_then_as_one_slip[7.0-0.3-quiet]": SWINGS,
    "test_a_load_below_the_friction_limit_is_never_gross[201]": NEAR_LIMIT,
    "test_a_load_that_comes_to_rest_is_not_gross[0.75-205]": NEAR_LIMIT,
    "test_a_physical_slide_is_found_before_it_is_gross[203-0.0003]": NEAR_LIMIT,
    "test_a_slow_pull_beyond_friction_is_gross": NEAR_LIMIT,
    "test_a_slip_right_after_the_start_is_found[20]": LATER,
    "test_a_slip_soon_after_a_swing_is_said": LATER,
    "test_channels_that_are_read_one_after_the_other_hardly_turn_a_sudden_slip": LATER,
    "test_settings_trade_early_against_sure": LATER,
    "test_a_channel_that_never_worked_takes_its_taxel_out": CHANNELS,
    "test_a_channel_that_sticks_in_a_hold_takes_its_taxel_out": CHANNELS,
    "test_a_noisy_channel_takes_its_taxel_out_and_costs_no_time": CHANNELS,
    "test_a_side_that_is_stuck_from_the_start_costs_no_confidence": CHANNELS,
    "test_broken_channels_do_not_hide_a_slip": CHANNELS,
    "test_a_press_at_a_slant_is_no_slip[0.3-0.6]": SLANT,
    "test_a_press_at_a_slant_is_no_slip[0.3-0.9]": SLANT,
    "test_a_press_at_a_slant_is_no_slip[1.5-0.6]": SLANT,
    "test_a_press_at_a_slant_is_no_slip[1.5-0.9]": SLANT,
    "test_a_slide_is_gross_on_arrays_of_any_scale[normal-4x4-balanced]": NO_SHEAR,
    "test_a_slide_is_gross_on_arrays_of_any_scale[normal-4x4-fast]": NO_SHEAR,
    "test_pads_without_shear_channels_tell_slip_without_direction": NO_SHEAR,
    "test_a_slip_inside_a_gap_is_reported": GAP,
    "test_the_contact_then_slides": GAP,
    "test_a_slip_that_began_in_a_gap_is_found_by_its_going_on": GAP,
}
# Not run: hypothesis would look for the smallest of many failures, and an hour takes as long as the others.
NOT_RUN = {
    "test_a_slide_is_told_whole_early_and_in_its_direction": UNIFORM,
    "test_a_slip_that_lasts_an_hour_is_one_slip": UNIFORM,
    "test_neighbouring_channels_that_jump_are_no_slip": CHANNELS,
}


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark the tests of the tables as known to fail; other folders may have tests of the same names."""
    for item in items:
        if item.path.parent != _HERE:
            continue
        function = item.name.partition("[")[0]
        if reason := KNOWN.get(item.name) or KNOWN.get(function):
            item.add_marker(pytest.mark.xfail(reason=reason, strict=True))
        elif reason := NOT_RUN.get(function):
            item.add_marker(pytest.mark.xfail(reason=reason, run=False))
