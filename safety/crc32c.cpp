// SPDX-License-Identifier: Apache-2.0
#include "safety/crc32c.hpp"
