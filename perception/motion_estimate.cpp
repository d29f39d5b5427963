// SPDX-License-Identifier: Apache-2.0
#include "perception/motion_estimate.hpp"
