// SPDX-License-Identifier: Apache-2.0
#include "safety/end_to_end.hpp"
