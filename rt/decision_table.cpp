// SPDX-License-Identifier: Apache-2.0
#include "rt/decision_table.hpp"

#include <cmath>
#include <iterator>

#include <Eigen/Geometry>
#include <fmt/format.h>

namespace holdfast::rt {
namespace {

/// Separated by spaces, lowest code first.
void append_names(std::string& text, safety::ReasonSet reasons) {
  for (bool is_first = true; !reasons.empty(); is_first = false) {
    const safety::Reason reason = reasons.primary();
    if (!is_first) text += ' ';
    text += safety::name(reason);
    reasons.erase(reason);
  }
}

}  // namespace

std::string decision_table_header() {
  return "cycle,t_ns,mode,cause,reasons,changed,stop_id,frame,t_exposure_ns,t_evidence_ns,"
         "sigma_target_mm,is_approved,t_pose_ns,tx_mm,ty_mm,tz_mm,qx,qy,qz,qw\n";
}

void append_decision_row(std::string& text, const RecordedInput& input,
                         const ControlOutput& output) {
  const safety::Decision& d = output.decision;
  const auto end = std::back_inserter(text);
  fmt::format_to(end, "{},{},{},{},", input.cycle, input.t_decided.count(), name(d.mode),
                 name(d.cause));
  append_names(text, d.reasons);
  fmt::format_to(end, ",{:d},{},", d.changed, d.stop_id);
  if (output.frame > 0)
    fmt::format_to(end, "{},{},", output.frame, output.t_exposure.count());
  else
    text += ",,";
  fmt::format_to(end, "{},", output.t_evidence.count());
  if (std::isfinite(output.sigma_target_mm)) fmt::format_to(end, "{}", output.sigma_target_mm);
  if (!d.approved) {
    text += ",0,,,,,,,,\n";
    return;
  }
  const Eigen::Vector3d t = d.approved->T_robot_ct().translation();
  const Eigen::Quaterniond q(d.approved->T_robot_ct().linear());
  fmt::format_to(end, ",1,{},{},{},{},{},{},{},{}\n", d.approved->t_pose().count(), t.x(), t.y(),
                 t.z(), q.x(), q.y(), q.z(), q.w());
}

}  // namespace holdfast::rt
