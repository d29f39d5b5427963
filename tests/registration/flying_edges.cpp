// SPDX-License-Identifier: Apache-2.0
#include "tests/registration/flying_edges.hpp"

#include <vtkFlyingEdges3D.h>
#include <vtkImageData.h>
#include <vtkNew.h>
#include <vtkSMPTools.h>

namespace holdfast {

void run_flying_edges(vtkImageData* image, double iso_hu) {
  vtkNew<vtkFlyingEdges3D> filter;
  filter->SetInputData(image);
  filter->ComputeNormalsOff();
  filter->ComputeGradientsOff();
  filter->ComputeScalarsOff();
  filter->SetValue(0, iso_hu);
  vtkSMPTools::SetBackend("STDThread");
  vtkSMPTools::LocalScope(vtkSMPTools::Config{2}, [&] { filter->Update(); });
}

}  // namespace holdfast
