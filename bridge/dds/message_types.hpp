// SPDX-License-Identifier: Apache-2.0
// Short names of the C types that idlc makes of bridge/idl/holdfast.idl, which says what each field
// means. All are trivially copyable: no field points to memory of its own.
#pragma once

#include <concepts>

#include "bridge/idl/holdfast.h"

namespace holdfast::msg {

using Protection = holdfast_msg_Protection;
using CompensatedPose = holdfast_msg_CompensatedPose;
using MotionStop = holdfast_msg_MotionStop;
using TrackingHealth = holdfast_msg_TrackingHealth;
using RegistrationInfo = holdfast_msg_RegistrationInfo;
using RobotStatus = holdfast_msg_RobotStatus;
using OperatorCommand = holdfast_msg_OperatorCommand;
using GuardPermission = holdfast_msg_GuardPermission;

template <class M>
concept Message = std::same_as<M, CompensatedPose> || std::same_as<M, MotionStop> ||
    std::same_as<M, TrackingHealth> || std::same_as<M, RegistrationInfo> ||
    std::same_as<M, RobotStatus> || std::same_as<M, OperatorCommand> ||
    std::same_as<M, GuardPermission>;

}  // namespace holdfast::msg
