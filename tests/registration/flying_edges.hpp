// SPDX-License-Identifier: Apache-2.0
// What the isosurface is measured against: VTK's flying edges on two threads.
#pragma once

class vtkImageData;

namespace holdfast {
void run_flying_edges(vtkImageData* image, double iso_hu);
}  // namespace holdfast
