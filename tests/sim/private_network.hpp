// SPDX-License-Identifier: Apache-2.0
// A loopback network of this process's own, so that tests with cameras (whose UDP port is fixed)
// and DDS run side by side.
#pragma once

namespace holdfast::sim {

/// Moves the calling thread, the threads it starts and the programs it runs into a network with
/// nothing but a loopback interface, 127.0.0.1 and 127.0.0.2. Call before the first thread. Where
/// the system does not allow that, waits instead until no other process that called this is left on
/// the host's network. Throws UnavailableError when neither works.
void enter_private_network();

}  // namespace holdfast::sim
