"""One thread, as in training: small networks only lose by more, badly so on a busy machine."""

import torch

torch.set_num_threads(1)
