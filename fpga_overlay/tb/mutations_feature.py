"""Mistakes in the feature core that its tests must notice."""

from __future__ import annotations

from functools import partial

from fpga_overlay.tb.mutation import Mutation

_of_core = partial(
    Mutation,
    top="feature_core",
    bench="fpga_overlay.tb.feature_core",
    parameters=(("RINGS", 8), ("COLUMNS", 64), ("BANK_WORDS", 64)),
)
_HAZARD = "the_first_point_of_a_cell_wins_however_soon_the_next_one_follows"
_SCANS = "scans_of_every_size_come_back_as_the_model_says"
_EXACT = "thresholds_are_compared_exactly"
_SHORT = "rings_of_few_points_have_no_window"
_SECTORS = "any_number_of_sectors_up_to_seven_divides_a_ring"
_TRACES = "bypassed_empty_and_bad_packets_leave_no_trace"
_STRAYS = "points_without_the_valid_flag_or_outside_the_geometry_are_left_out"
_RESET = "a_reset_at_any_time_leaves_an_empty_core"

MUTATIONS = [
    # The image
    _of_core("hazard-one-short", "cell_writer.sv", "k <= UNSEEN; k++) if", "k < UNSEEN; k++) if", _HAZARD),
    _of_core("hazard-unseen", "cell_writer.sv", "taken = same_3 || ", "taken = ", _HAZARD),
    _of_core("both-cells-written", "cell_writer.sv", "{cells[3][0], !cells[3][0]}", "{2'b11}", _HAZARD),
    _of_core("other-bank-chosen", "range_image.sv", ".select(choice)", ".select(~choice)", _SCANS),
    _of_core("odd-last-column-stays", "ring_scanner.sv", "(column[0] || row_ends)", "column[0]", _SCANS),
    _of_core("last-ring-not-wiped", "ring_scanner.sv", "RING_BITS'(RINGS - 1);", "RING_BITS'(RINGS - 2);", _RESET),
    _of_core("counter-goes-on", "ring_scanner.sv", "ring_clear = state == RING ||", "ring_clear =", _SCANS),
    _of_core("scan-before-last-writes", "feature_core.sv", "state == SETTLE && !filling", "state == SETTLE", _SCANS),
    # The window
    _of_core("five-empty-steps", "ring_scanner.sv", "FLUSH = 3'd6", "FLUSH = 3'd5", _SHORT),
    _of_core("sum-of-twelve", "ring_window.sv", "AHEAD + BEHIND - 1", "AHEAD + BEHIND", _SCANS),
    _of_core("sum-from-ring-before", "ring_window.sv", "sum      <= 22'd0;", "sum      <= sum;", _SCANS),
    _of_core("last-difference", "feature_window.sv", "position <= step_count;", "position < step_count;", _SHORT),
    _of_core(
        "one-more-event",
        "feature_window.sv",
        "position + 12'd6 <= step_count",
        "position + 12'd5 <= step_count",
        _SHORT,
    ),
    _of_core("ten-columns-are-near", "feature_window.sv", "< 11'd10", "<= 11'd10", _EXACT),
    _of_core("five-after", "reliability.sv", "AFTER = 6", "AFTER = 5", _SCANS),
    _of_core("four-before", "reliability.sv", "was_behind != '0", "was_behind[BEFORE-1:1] != '0", _SCANS),
    _of_core(
        "occlusion-at-limit",
        "reliability.sv",
        "behind_3 <= !away_2 && close[2] && magnitude_2 >",
        "behind_3 <= !away_2 && close[2] && magnitude_2 >=",
        _EXACT,
    ),
    _of_core("parallel-in-pauses", "reliability.sv", "if (pushed[3]) steep", "if (1'b1) steep", _SCANS),
    _of_core("parallel-48-fold", "reliability.sv", " + {5'd0, magnitude_2, 1'b0}", "", _EXACT),
    _of_core("corner-at-limit", "curvature.sv", "> corner", ">= corner", _EXACT),
    _of_core("flat-at-limit", "curvature.sv", "< flat", "<= flat", _EXACT),
    _of_core("border-belongs-before", "sector_of_point.sv", "scaled > borders", "scaled >= borders", _SECTORS),
    _of_core("seventh-last-in-sector", "sector_of_point.sv", "position < count", "position <= count", _SECTORS),
    _of_core("no-sectors-are-one", "sector_of_point.sv", " && sectors != 4'd0", "", _SECTORS),
    # Packets
    _of_core("odd-record-lost", "record_packer.sv", "half && (record_valid || flush)", "half && record_valid", _SCANS),
    _of_core("odd-beat-not-zero", "record_packer.sv", "record_valid ? record : 64'd0", "record", _SCANS),
    _of_core("index-goes-on", "feature_core.sv", "if (taken == 2'd0) index <=", "if (!rst_n) index <=", _SCANS),
    _of_core("invalid-points-stored", "feature_core.sv", "stores = held[68] && ", "stores = ", _STRAYS),
    _of_core("columns-unchecked", "feature_core.sv", "held_column < columns && ", "", _STRAYS),
    _of_core("rings-unchecked", "feature_core.sv", "held_ring < rings && ", "", _STRAYS),
    _of_core("status-ignored", "feature_core.sv", "quiet = held[7:0] != 8'd0", "quiet = 1'b0", _TRACES),
    _of_core("feature-bypass-ignored", "feature_core.sv", "active = fits && !bypassed", "active = fits", _TRACES),
    _of_core("eight-sectors", "feature_core.sv", " && !sector_count[3]", "", _TRACES),
    _of_core("fifo-runs-over", "feature_core.sv", ".ROOM (16)", ".ROOM (31)", _SCANS),
    _of_core("slice-drops-a-beat", "stream_skid.sv", "spare_valid ? spare : s_data", "s_data", _SCANS),
]
