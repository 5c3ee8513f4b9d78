"""Still poses: each is estimated by itself, since none says anything of the motion to the next."""
